"""What air takes per octave of a rendered response, against ISO 9613-1: the table of docs/rendering.md.

Question: By how much is what air takes from a response off, octave by octave?

Method: Errors in dB of the energy in an octave against ISO 9613-1 at 20 °C, 50 %, for bands as
`soundspaces_rlr` divides them: of the direct sound alone, and of reverberation in 50 ms about the time at
which sound has travelled so far, over eight draws of noise, beside the same noise without air.

Amortised: Nothing is timed.

Takes: 2 minutes.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from soundspaces_rlr.records import band_edges

import soundspaces_sim as ss
from benchmarks.tools.record import Table, table
from soundspaces_sim.core.numerics.air import Air
from soundspaces_sim.echogram.echogram import Arrival, Arrivals

MEASURES = ("core", "echogram", "rendering")
RATE = 44100
COUNTS, METRES = (1, 4, 6, 8, 10), (10.0, 50.0, 100.0, 200.0)
OCTAVES = (63, 125, 250, 500, 1000, 2000, 4000, 8000)
SEEDS = 8
AIR = Air()


def expected(octave: float, metres: float) -> float:
    """What is left of the energy of an octave, even per Hz: mean over 4,000 frequencies."""
    f = octave * (2.0**-0.5 + (2.0**0.5 - 2.0**-0.5) * (np.arange(4000) + 0.5) / 4000)
    return float(np.exp(-metres * AIR.attenuation(f)).mean())


def echogram(bands: tuple[float, ...], metres: float, direct: bool) -> ss.Echogram:
    """Sound of unit energy in all bands but for what air takes: an arrival, or the bins about its time."""
    n, width = len(bands) - 1, 0.001
    centre = round(metres / AIR.speed_of_sound / width)
    table = np.zeros((centre + 30, 9, n), np.float32)
    edges = np.arange(len(table) + 1) * width
    arrival = None
    if direct:
        left = AIR.transmission(bands, metres)
        arrival = Arrival(metres / AIR.speed_of_sound, left, np.array([1.0, 0.0, 0.0]))
    else:
        near = slice(max(centre - 25, 0), centre + 25)
        middles = 0.5 * (edges[1:] + edges[:-1])[near]
        table[near, 0] = AIR.transmission(bands, middles * AIR.speed_of_sound)
    none = Arrivals(np.empty(0), np.empty((0, n)), np.empty((0, 3)), np.empty((0, 2), int))
    return ss.Echogram(bands, edges, table, arrival, none, np.zeros((2, n)), direct, air=AIR)


def octave_levels(response: np.ndarray) -> np.ndarray:
    """(octaves,) energies."""
    size = 1 << 17
    power = np.abs(np.fft.rfft(response.astype(float), size)) ** 2
    f = np.fft.rfftfreq(size, 1.0 / RATE)
    return np.array([power[(f >= o * 2.0**-0.5) & (f < o * 2.0**0.5)].sum() for o in OCTAVES])


def errors(count: int, metres: float, direct: bool) -> np.ndarray:
    """(octaves,) dB: what air takes in a response, over what it should; beside the same noise without air."""
    bands = band_edges(count)
    with_air = echogram(bands, metres, direct)
    flat = np.ones(len(bands) - 1)
    if direct:
        assert with_air.direct is not None
        without = replace(with_air, air=None, direct=replace(with_air.direct, energy=flat))
    else:
        loud = (with_air.energy[:, :1] > 0.0).astype(np.float32)
        without = replace(with_air, air=None, energy=loud * np.eye(9, dtype=np.float32)[0][:, None])
    energies = np.zeros((2, len(OCTAVES)))
    for seed in range(1 if direct else SEEDS):
        for row, each in zip(energies, (with_air, without), strict=True):
            row += octave_levels(ss.ambisonic_rir(each, RATE, seed)[0])
    travelled = np.array([metres])
    if not direct:
        edges = with_air.time_edges
        lit = with_air.energy[:, 0, 0] > 0.0
        travelled = 0.5 * (edges[1:] + edges[:-1])[lit] * AIR.speed_of_sound
    wanted = [np.mean([expected(o, x) for x in travelled]) for o in OCTAVES]
    return np.asarray(10.0 * np.log10(energies[0] / energies[1] / wanted))


def run() -> list[Table]:
    """Errors, and what the standard says."""
    heads = [f"{o} Hz" for o in OCTAVES]
    rows = [
        (
            count,
            metres,
            name,
            *(f"{e:+.4f}" if direct else f"{e:+.2f}" for e in errors(count, metres, direct)),
        )
        for count in COUNTS
        for metres in METRES
        for direct, name in ((True, "direct"), (False, "late"))
    ]
    losses = [(metres, *(-10.0 * np.log10(expected(o, metres)) for o in OCTAVES)) for metres in METRES]
    return [
        table("Errors in dB", ["bands", ("way", "m"), "sound", *heads], rows),
        table("What ISO 9613-1 takes, dB", [("way", "m"), *heads], losses),
    ]
