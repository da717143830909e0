"""The genuine rlr_audio_propagation and `soundspaces_sim.rlr` in a box, against what is known of it.

Question: Where both engines differ, which of them agrees with a known answer?

Method: The same calls to both, at their defaults (5,000 rays, one thread), in a box of 6 × 5 × 2.7 m. First
reflections of walls that scatter all they reflect against their integral; energy by absorption; T30 of walls
that absorb what they do not reflect, and of walls that let it through into the open; what 100 m of air take
against ISO 9613-1; T30 by scattering against image sources (Allen and Berkley 1979, as energies).

Amortised: Nothing is timed.

Takes: 10 minutes. Needs rlr-audio-propagation 0.0.1 (licensed for non-commercial use).
"""

from __future__ import annotations

import itertools
from types import ModuleType

import numpy as np

from benchmarks.tools.record import Table, table
from benchmarks.tools.rlr import (
    LENGTH_S,
    OCTAVES,
    RATE,
    SPEED,
    box_of,
    context,
    genuine,
    octave_measures,
    populate,
    responses,
    simulations,
)
from benchmarks.tools.scenes import BOX
from soundspaces_sim.core.numerics.air import Air
from soundspaces_sim.echogram.measures import reverberation_times
from soundspaces_sim.rlr import api

MEASURES = ("core", "scene", "transport", "echogram", "rendering", "rlr")
LOW, HIGH = 775.0, 3409.0
_HERTZ = [(f"{f}", "Hz") for f in OCTAVES]


def first_reflection(source: np.ndarray, listener: np.ndarray, absorption: float) -> float:
    """Energy at the listener, for 1 J emitted, of what the walls of the box scatter once by Lambert's law: the
    integral over the walls of cos a / (4 pi r²) * (1 - absorption) * cos b / (pi s²)."""
    total, count = 0.0, 400
    cell = (np.arange(count) + 0.5) / count
    for axis, side in itertools.product(range(3), (0.0, 1.0)):
        wall = np.empty((count, count, 3))
        first, second = (i for i in range(3) if i != axis)
        wall[..., axis] = side * BOX[axis]
        wall[..., first], wall[..., second] = cell[:, None] * BOX[first], cell[None, :] * BOX[second]
        to, on = wall - source, listener - wall
        r2, s2 = (to**2).sum(axis=2), (on**2).sum(axis=2)
        cosines = np.abs(to[..., axis] * on[..., axis]) / np.sqrt(r2 * s2)
        area = BOX[first] * BOX[second] / count**2
        total += float((cosines / (4.0 * np.pi * r2) * (1.0 - absorption) / (np.pi * s2)).sum()) * area
    return total


def _early(module: ModuleType, sources: np.ndarray, listeners: np.ndarray, runs: int) -> Table:
    absorption = 0.95
    exact = np.array([first_reflection(s, l, absorption) for s in sources for l in listeners])
    rows = []
    for who, each in (("ours", api), ("theirs", module)):
        made = context(each, box_of(absorption, 1.0), direct=0)
        populate(each, made, sources, listeners)
        ratios = []
        for _ in simulations(made, runs):
            irs = responses(made, len(sources), len(listeners))
            spectrum = np.abs(np.fft.rfft(irs, axis=1)) ** 2
            frequency = np.fft.rfftfreq(irs.shape[1], 1.0 / RATE)
            ratios.append(spectrum[:, (frequency > LOW) & (frequency < HIGH)].mean(axis=1) / exact)
        values = np.array(ratios).mean(axis=1)
        rows.append((who, values.mean(), values.std(ddof=1) / np.sqrt(runs)))
    return table(
        f"Reflections over the integral of the first, absorption {absorption}, scattering 1",
        ["", "ratio", "standard error"], rows, "The second and later reflections add some 4 %.",
    )  # fmt: skip


def _by_absorption(module: ModuleType, sources: np.ndarray, listeners: np.ndarray, runs: int) -> Table:
    rows = []
    for absorption in (0.95, 0.5, 0.2):
        levels = []
        for each in (api, module):
            made = context(each, box_of(absorption, 1.0), direct=0)
            populate(each, made, sources, listeners)
            energy = np.zeros(len(OCTAVES))
            for _ in simulations(made, runs):
                found = octave_measures(responses(made, len(sources), len(listeners)))["level"]
                energy += (10.0 ** (found / 10.0)).sum(axis=0)
            levels.append(10.0 * np.log10(energy))
        rows.append((absorption, *(levels[1] - levels[0])))
    return table("Reflections, scattering 1: theirs over ours, dB", ["absorption", *_HERTZ], rows)


def _decay(
    each: ModuleType,
    sources: np.ndarray,
    listeners: np.ndarray,
    *walls: float | None,
    through: float = 0.0,
) -> np.ndarray:
    """(octaves,) mean T30 in s of the box with `walls`: absorption, scattering, absorption of the ceiling."""
    absorption, scattering, ceiling = walls
    assert absorption is not None and scattering is not None
    made = context(each, box_of(absorption, scattering, ceiling, through))
    populate(each, made, sources, listeners)
    made.simulate()
    found = octave_measures(responses(made, len(sources), len(listeners)))["T30"]
    return np.asarray(np.nanmean(found, axis=0))


def _by_what_takes_it(module: ModuleType, sources: np.ndarray, listeners: np.ndarray) -> Table:
    rows = []
    for (absorption, through), (who, each) in itertools.product(
        ((0.3, 0.0), (0.1, 0.2)), (("ours", api), ("theirs", module))
    ):
        decay = _decay(each, sources, listeners, absorption, 1.0, None, through=through)
        rows.append((absorption, through, who, *decay))
    return table(
        "T30 in s, scattering 1, thin walls into the open that reflect .7: the decay must be the same",
        ["absorbed", "let through", "", *_HERTZ], rows,
    )  # fmt: skip


def image_decay(
    source: np.ndarray, listener: np.ndarray, absorption: float, ceiling: float
) -> np.ndarray:
    """Energy per ms of all image sources of the box without scattering (Allen and Berkley 1979, as energies)."""
    box, axes = np.array(BOX), []
    for k in range(3):
        n = np.arange(
            -int(LENGTH_S * SPEED / (2.0 * box[k])) - 2, int(LENGTH_S * SPEED / (2.0 * box[k])) + 3
        )
        place = np.concatenate([2 * n * box[k] + source[k], 2 * n * box[k] - source[k]]) - listener[k]
        low, high = np.concatenate([np.abs(n), np.abs(n - 1)]), np.concatenate([np.abs(n), np.abs(n)])
        far = ceiling if k == 2 else absorption
        axes.append((place, (1.0 - absorption) ** low * (1.0 - far) ** high))
    grids = np.ix_(*(place**2 for place, _ in axes))
    square = grids[0] + grids[1] + grids[2]
    factors = np.ix_(*(kept for _, kept in axes))
    kept = factors[0] * factors[1] * factors[2]
    ms = (np.sqrt(square) / SPEED * 1e3).astype(int)
    use = ms < round(LENGTH_S * 1e3)
    return np.bincount(ms[use], kept[use] / (4.0 * np.pi * square[use]), round(LENGTH_S * 1e3))


def _against_images(module: ModuleType, sources: np.ndarray, listeners: np.ndarray) -> Table:
    hard, soft = 0.1, 0.7
    energy = [image_decay(s, l, hard, soft) for s in sources for l in listeners]
    exact = np.mean([reverberation_times(e, 0.001, -5.0, -35.0)[0] for e in energy])
    rows = [
        (scattering, who, *_decay(each, sources, listeners, hard, scattering, soft))
        for scattering, (who, each) in itertools.product(
            (0.0, 0.1, 0.3, 1.0), (("ours", api), ("theirs", module))
        )
    ]
    note = f"Image sources, without scattering and air: {exact:.2f} s."
    return table(f"T30 in s, absorption {hard}, ceiling {soft}", ["scattering", "", *_HERTZ], rows, note)


def _air(module: ModuleType) -> Table:
    air = Air()
    rows: list[tuple[object, ...]] = []
    for who, each in (("ours", api), ("theirs", module)):
        config = each.Config()
        config.sample_rate = float(RATE)
        made = each.Context(config)
        levels = []
        for distance in (10.0, 110.0):
            populate(each, made, np.array([[distance, 0.0, 0.0]]), np.zeros((1, 3)))
            made.simulate()
            levels.append(octave_measures(responses(made, 1, 1))["level"][0])
        rows.append((who, *(levels[0] - levels[1] - 20.0 * np.log10(11.0))))
    left = [
        [
            np.exp(-m * air.attenuation(f * 2.0 ** ((np.arange(4000) + 0.5) / 4000 - 0.5))).mean()
            for m in (10.0, 110.0)
        ]
        for f in OCTAVES
    ]
    rows.insert(0, ("ISO 9613-1", *(10.0 * np.log10(near / far) for near, far in left)))
    return table("Air, dB per 100 m, from 10 to 110 m, 20 °C, 50 %", ["", *_HERTZ], rows)


def run() -> list[Table]:
    """Both beside known answers."""
    module = genuine()
    places = np.random.default_rng(0).uniform(0.5, np.array(BOX) - 0.5, (10, 3))
    few = places[:2], places[4:8]
    return [
        _early(module, places[:4], places[4:], 12),
        _by_absorption(module, *few, 2),
        _by_what_takes_it(module, *few),
        _air(module),
        _against_images(module, *few),
    ]
