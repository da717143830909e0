"""Other programs, and ours beside them, in measured rooms: the same meshes, tables, positions and measures.

Question: By how many just-noticeable differences are other programs off in the same measured rooms?

Method: Mean errors in JND (`ptb_studio`) of the measures of their responses, acoustic-spaces' of its energies in
steps of 1 ms, ours of echograms of 1,000 subpaths. rlr-audio-propagation at its defaults (5,000 rays) but for the
response's length; pyroomacoustics by ray tracing alone (10,000 rays), for its image sources do not take such
meshes, and told by our rays which pairs are in sight; acoustic-spaces at its defaults (20,000 rays for early
paths, 50,000 for late energy) on one thread, without diffraction, for which it needs more memory than there is. A
program that takes longer than ten minutes of the processor for a room is stopped, and so is one that wants more
than 16 GB of memory; one that ends with an error is quoted.

Amortised: Reading the scene is part of the processor time, and so is what a program compiles.

Takes: An hour. Needs the programs of benchmarks/requirements.txt, and rooms of `ptb_studio` or
`public_rooms`.
"""

from __future__ import annotations

import importlib
import importlib.util
import json
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Callable

import numpy as np

import soundspaces_sim as ss
from benchmarks.accuracy import ptb_experiments, ptb_studio, public_rooms
from benchmarks.tools import rlr
from benchmarks.tools.programs import MEMORY_BYTES, acoustic_spaces
from benchmarks.tools.record import Table, UnavailableError, table
from soundspaces_sim.echogram.measures import (
    RoomMeasures,
    energy_measures,
    room_measures,
    waveform_measures,
)

_NAMES = {"T20": "t20", "T30": "t30", "EDT": "edt", "C": "c80", "D": "d50"}
_LENGTH_S, _RATE, _STEP_S = 3.0, 44100, 0.001
LIMIT_S = 600  # of the processor
SECONDS = "seconds"  # of the processor, beside errors
Bands = tuple[float, ...]  # edges, Hz


def _ours(
    scene: ss.Scene, sources: np.ndarray, receivers: np.ndarray, bands: Bands
) -> list[RoomMeasures]:
    config = ss.SimulationConfig(bands=bands, walks=1000, max_duration=_LENGTH_S)
    echoes = ss.simulate(scene, sources, receivers, config)
    return [room_measures(echoes[s, l]) for s in range(len(sources)) for l in range(len(receivers))]


def _rlr(
    scene: ss.Scene, sources: np.ndarray, receivers: np.ndarray, bands: Bands
) -> list[RoomMeasures]:
    module = importlib.import_module("rlr_audio_propagation")
    made = rlr.context(module, scene, max_ir_length=_LENGTH_S)
    rlr.populate(module, made, sources, receivers)
    made.simulate()
    return [
        waveform_measures(np.asarray(made.get_ir_channel(l, s, 0)), _RATE, bands)
        for s in range(len(sources))
        for l in range(len(receivers))
    ]


def _acoustic_spaces(
    scene: ss.Scene, sources: np.ndarray, receivers: np.ndarray, bands: Bands
) -> list[RoomMeasures]:
    program = importlib.import_module(acoustic_spaces.MODULE)
    room = acoustic_spaces.prepared(scene, sources, receivers, {"ir_length_s": _LENGTH_S})
    found = acoustic_spaces.by_pair(program.simulate(room), len(sources), len(receivers))
    octaves = np.searchsorted(bands, np.array(found[0].band_hz, float)) - 1
    if (octaves >= 0).sum() < len(bands) - 1:
        raise ValueError(f"expected an octave in each of {bands}, got {found[0].band_hz}")
    energies = [r.energy(_STEP_S)[(octaves >= 0) & (octaves < len(bands) - 1)] for r in found]
    return [energy_measures(e, _STEP_S, _STEP_S * e.any(axis=0).argmax()) for e in energies]


def _pyroom(
    scene: ss.Scene, sources: np.ndarray, receivers: np.ndarray, bands: Bands
) -> list[RoomMeasures]:
    pra = importlib.import_module("pyroomacoustics")
    table, octaves = scene.materials, pra.acoustics.OctaveBandsFactory(fs=_RATE)
    walls = []
    made = {}
    for i, name in enumerate(table.names):
        centres = list(table.frequency_hz)
        made[i] = pra.Material(
            energy_absorption={
                "description": name,
                "coeffs": list(table.absorption[i]),
                "center_freqs": centres,
            },
            scattering={
                "description": name,
                "coeffs": list(table.scattering[i]),
                "center_freqs": centres,
            },
        )
        made[i].resample(octaves)
    for corners, i in zip(scene.corners, scene.face_material, strict=True):
        m = made[int(i)]
        walls.append(
            pra.wall_factory(np.ascontiguousarray(corners.T), m.absorption_coeffs, m.scattering_coeffs)
        )
    bare = ss.SimulationConfig(
        walks=16,
        duration=0.1,
        radiance_transfer=ss.RadianceTransferConfig(enabled=False),
        diffraction=ss.DiffractionConfig(enabled=False),
        scattering="table",
    )
    in_sight = ss.simulate(scene, sources, receivers, bare).walls == 0
    out = []
    for source, seen in zip(sources, in_sight, strict=True):
        room = pra.Room(walls, fs=_RATE, max_order=0, ray_tracing=True, air_absorption=True)
        room.set_ray_tracing(n_rays=10_000, time_thres=_LENGTH_S)
        room.add_source(source)
        room.add_microphone_array(receivers.T)
        # Its own test of sight fails for pairs in the studio, and without any direct sound it stops with an error.
        room.image_source_model()
        for sees, really in zip(room.visibility[0], seen, strict=True):
            sees[:] = really
        room.compute_rir()
        out += [waveform_measures(np.asarray(row[0]), _RATE, bands) for row in room.rir]
    return out


# Measures of each pair, sources outermost.
PROGRAMS: dict[str, Callable[[ss.Scene, np.ndarray, np.ndarray, Bands], list[RoomMeasures]]] = {
    "soundspaces_sim": _ours,
    "rlr_audio_propagation": _rlr,
    "pyroomacoustics": _pyroom,
    "acoustic_spaces": _acoustic_spaces,
}


def installed() -> list[str]:
    """The programs that can be imported."""
    return [name for name in PROGRAMS if importlib.util.find_spec(name)]


def measures(
    program: str, scene: ss.Scene, sources: np.ndarray, receivers: np.ndarray, bands: Bands
) -> dict[str, np.ndarray]:
    """(pairs, octaves) per parameter, as a program computes them."""
    found = PROGRAMS[program](scene, sources, receivers, bands)
    return {p: np.array([getattr(m, name) for m in found]) for p, name in _NAMES.items()}


def studio(program: str, state: str) -> dict[str, float]:
    """Mean error in JND per parameter in the PTB studio, its curtains as mounted, for neither knows sheets."""
    scene, room = ptb_studio.load_studio(state, sheets=False)
    sources, receivers = (np.array(list(room[k].values()), float) for k in ("sources_m", "receivers_m"))
    found = measures(program, scene, sources, receivers, ptb_studio.config_of(room, 16).bands)
    return {p: float(np.nanmean(v)) for p, v in ptb_studio.against_measured(found, state).items()}


def public(program: str, name: str) -> dict[str, float]:
    """The same in a room of `public_rooms`."""
    room = public_rooms.load(name)
    found = measures(program, room.scene, room.sources, room.receivers, public_rooms.bands())
    return {p: float(np.nanmean(v)) for p, v in public_rooms.differences(room, found).items()}


def rooms() -> list[str]:
    """Names of the rooms that are there; `open` and `closed` are the studio, by its curtains."""
    return [*(ptb_experiments.STATES if ptb_studio.FOLDER.is_dir() else ()), *public_rooms.available()]


def errors(program: str, room: str) -> dict[str, float]:
    """Mean error in JND per parameter in a room of `rooms`, and `SECONDS` of the processor."""
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY_BYTES, MEMORY_BYTES))
    resource.setrlimit(resource.RLIMIT_CPU, (LIMIT_S, LIMIT_S + 1))
    began = time.process_time()
    found = studio(program, room) if room in ptb_experiments.STATES else public(program, room)
    return {**found, SECONDS: time.process_time() - began}


def errors_within(program: str, room: str) -> dict[str, float] | str:
    """`errors`, from a process of its own that has `LIMIT_S`; or why there are none."""
    command = [sys.executable, "-m", "benchmarks.accuracy.other_programs", program, room]
    try:
        done = subprocess.run(command, capture_output=True, check=True, text=True)
    except subprocess.CalledProcessError as error:
        if error.returncode == -signal.SIGXCPU:
            return f"stopped after {LIMIT_S / 60.0:g} minutes"
        return f"ended with {(error.stderr.strip() or str(error.returncode)).splitlines()[-1]}"
    found: dict[str, float] = json.loads(done.stdout.splitlines()[-1])
    return found


def run() -> list[Table]:
    """Errors by program and room."""
    if not installed() or not rooms():
        raise UnavailableError(
            f"none of {', '.join(PROGRAMS)} is installed, or there is no measured room"
        )
    rows: list[tuple[object, ...]] = []
    for program in installed():
        for room in rooms():
            off = errors_within(program, room)
            if isinstance(off, str):
                rows.append((program, room, *5 * (None,), off))
            else:
                mean = (off.get("T30", off.get("T20")), off["EDT"], off["C"], off["D"])
                rows.append((program, room, *mean, off[SECONDS], ""))
    columns = [(p, "JND") for p in ("T30 (T20)", "EDT", "C80", "D50")]
    heads = ["program", "room", *columns, ("processor", "s"), ""]
    return [table("Mean errors", heads, rows)]


if __name__ == "__main__":
    print(json.dumps(errors(*sys.argv[1:])))  # of a process that `errors_within` started
