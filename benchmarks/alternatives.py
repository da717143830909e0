"""Error against seconds per pair: this engine, SoundSpaces 2.0's, and pyroomacoustics, in one run.

    .venv/bin/python -m pip install -r benchmarks/requirements.txt
    .venv/bin/python -m benchmarks.alternatives

Each tool is compared with its own converged reference: mean |difference| of energy decay curves in dB,
per band, down to -30 dB, over the same 6 x 6 pairs. The house has the same mesh and materials in both
tools; ours computes all pairs of N = 180 points with nine moments each, RLR one mono response per pair,
which is its fastest way. The shoebox (6 x 5 x 2.7 m, absorption .2, scattering .3) is for
pyroomacoustics, which does not take a mesh of this size. A tool that is not installed is left out.
"""

from __future__ import annotations

import importlib.util
import itertools
import json
import tempfile
import time
from collections.abc import Callable

import numba
import numpy as np
import trimesh
from scipy.signal import butter, sosfiltfilt

import soundspaces_sim as ss
from benchmarks.engine import HOUSE, decay_curves
from soundspaces_sim.transport.integrator import simulate_tile
from soundspaces_sim.transport.model import make_model

RATE, BIN_S, LENGTH_S = 44100, 0.01, 0.8
EDGES = ss.SimulationConfig().bands
PAIRS = 6  # sources and listeners
BOX = (6.0, 5.0, 2.7)


def waveform_curves(irs: np.ndarray) -> np.ndarray:
    """(n, bins, bands) decay curves in dB of (n, samples) responses."""
    bins = round(LENGTH_S / BIN_S)
    curves = np.empty((len(irs), bins, len(EDGES) - 1))
    for b, (low, high) in enumerate(itertools.pairwise(EDGES)):
        sos = butter(4, [max(low, 20.0), min(high, 0.49 * RATE)], "bandpass", fs=RATE, output="sos")
        band = sosfiltfilt(sos, irs, axis=1)[:, : round(LENGTH_S * RATE)] ** 2
        energy = np.add.reduceat(band, np.arange(bins) * round(BIN_S * RATE), axis=1)
        curves[:, :, b] = 10.0 * np.log10(np.cumsum(energy[:, ::-1], axis=1)[:, ::-1] + 1e-30)
    return curves


def error_db(curves: np.ndarray, reference: np.ndarray) -> float:
    use = (reference - reference[:, :1]) > -30.0
    return float(np.abs(curves - reference)[use].mean())


def chosen_points(scene: ss.Scene) -> tuple[np.ndarray, np.ndarray]:
    """All grid points, the 2 x PAIRS of the comparison first."""
    grid = ss.make_grid(scene, 1.0).points
    return grid, grid[np.random.default_rng(0).permutation(len(grid))]


def mean_curves(curves: list[np.ndarray]) -> np.ndarray:
    """Decay curves in dB of the mean energy of several runs."""
    return np.asarray(10.0 * np.log10(np.mean([10.0 ** (c / 10.0) for c in curves], axis=0)))


def sweep(
    tool: str,
    unit: str,
    run: Callable[[int], tuple[float, np.ndarray]],
    settings: tuple[int, ...],
    reference: np.ndarray,
) -> list[tuple[float, float]]:
    """Print and return (seconds per pair, error in dB) of a tool at several settings."""
    rows = []
    for setting in settings:
        seconds, curves = run(setting)
        rows.append((seconds, error_db(curves, reference)))
        name = f"{setting} {unit}"
        print(f"{tool:<22s}{name:<16s}{seconds * 1e3:12.3f}{1.0 / seconds:12.1f}{rows[-1][1]:12.3f}",
              flush=True)  # fmt: skip
    return rows


def _header(title: str) -> None:
    print(
        f"\n{title}\n{'tool':<22s}{'setting':<16s}{'ms per pair':>12s}{'pairs/s':>12s}{'|dEDC| dB':>12s}"
    )


def ours(scene: ss.Scene, grid: np.ndarray, points: np.ndarray, settings: tuple[int, ...]) -> list:
    """Times with all of `points`, errors over the first PAIRS x next PAIRS of them."""
    few = points[: 2 * PAIRS]

    def run(walks: int, seed: int, at: np.ndarray) -> tuple[float, np.ndarray]:
        config = ss.SimulationConfig(duration=LENGTH_S, walks=walks)
        engine = make_model(scene, grid, config, seed)
        start = time.perf_counter()
        echoes = simulate_tile(engine, at, None)[0]
        seconds = (time.perf_counter() - start) / len(at) ** 2
        curves = decay_curves(echoes, BIN_S)[:PAIRS, PAIRS : 2 * PAIRS]
        return seconds, curves.reshape(-1, *curves.shape[2:])

    run(16, 0, few[:4])  # compile
    reference = mean_curves([run(8000, seed, few)[1] for seed in (901, 902)])
    return sweep("soundspaces_sim", "walks", lambda walks: run(walks, 1, points), settings, reference)


def _rlr_materials(scene: ss.Scene) -> dict:
    table = scene.materials
    rows = []
    for i, name in enumerate(table.names):
        columns = {
            key: np.column_stack([table.frequency_hz, values[i]]).ravel().tolist()
            for key, values in (
                ("absorption", table.absorption),
                ("scattering", table.scattering),
                ("transmission", table.transmission),
            )
        }
        damping = np.column_stack([table.frequency_hz, np.zeros(len(table.frequency_hz))])
        rows.append(
            {"name": name, "labels": [name], "speed": 2000.0, "density": 1500.0,
             "damping": damping.ravel().tolist(), **columns}
        )  # fmt: skip
    return {"materials": rows}


def rlr(scene: ss.Scene, points: np.ndarray) -> list:
    """SoundSpaces 2.0's engine, Y up; its default is 5000 rays."""
    import rlr_audio_propagation as rlr_module

    def run(rays: int) -> tuple[float, np.ndarray]:
        config = rlr_module.Config()
        config.thread_count = numba.get_num_threads()
        config.max_ir_length, config.sample_rate = LENGTH_S, float(RATE)
        config.indirect_ray_count = rays
        context = rlr_module.Context(config)
        with tempfile.NamedTemporaryFile("w", suffix=".json") as file:
            json.dump(_rlr_materials(scene), file)
            file.flush()
            context.set_material_database_json(file.name)
        context.add_object()
        y_up = scene.vertices[:, [0, 2, 1]] * [1.0, 1.0, -1.0]
        context.add_mesh_vertices(y_up.ravel().tolist())
        for i, name in enumerate(scene.materials.names):
            faces = scene.faces[scene.face_material == i]
            if len(faces):
                context.add_mesh_indices(faces.ravel().tolist(), 3, name)
        context.finalize_object_mesh(0)
        context.add_source()
        mono = rlr_module.ChannelLayout(rlr_module.ChannelLayoutType.Mono, 1)
        context.add_listener(mono)
        irs, seconds = [], 0.0
        for source in points[:PAIRS]:
            for listener in points[PAIRS : 2 * PAIRS]:
                context.set_source_position(0, [source[0], source[2], -source[1]])
                context.set_listener_position(0, [listener[0], listener[2], -listener[1]])
                start = time.perf_counter()
                context.simulate()
                seconds += time.perf_counter() - start
                ir = np.array(context.get_ir_channel(0, 0, 0))[: round(LENGTH_S * RATE)]
                irs.append(np.pad(ir, (0, round(LENGTH_S * RATE) - len(ir))))
        return seconds / PAIRS**2, waveform_curves(np.array(irs))

    reference = mean_curves([run(20000)[1] for _ in range(2)])
    return sweep("rlr-audio-propagation", "rays", run, (250, 1000, 5000), reference)


def _shoebox() -> ss.Scene:
    mesh = trimesh.creation.box(extents=BOX)
    materials = ss.MaterialTable(["wall"], [1000.0], [[0.2]], [[0.3]], [[0.0]])
    zeros = np.zeros(len(mesh.faces), int)
    return ss.Scene(mesh.vertices + np.array(BOX) / 2.0, mesh.faces, zeros, materials, name="shoebox")


def pyroomacoustics(points: np.ndarray) -> list:
    """Image sources to order 3, ray tracing beyond; all listeners in one call, its fastest way."""
    import pyroomacoustics as pra

    def run(rays: int) -> tuple[float, np.ndarray]:
        irs, seconds = [], 0.0
        for source in points[:PAIRS]:
            material = pra.Material(energy_absorption=0.2, scattering=0.3)
            room = pra.ShoeBox(
                BOX, fs=RATE, materials=material, max_order=3, ray_tracing=True, air_absorption=True
            )
            room.set_ray_tracing(n_rays=rays, hist_bin_size=0.004)
            room.add_source(source)
            room.add_microphone_array(points[PAIRS : 2 * PAIRS].T)
            start = time.perf_counter()
            room.compute_rir()
            seconds += time.perf_counter() - start
            for row in room.rir:
                ir = np.asarray(row[0])[: round(LENGTH_S * RATE)]
                irs.append(np.pad(ir, (0, round(LENGTH_S * RATE) - len(ir))))
        return seconds / PAIRS**2, waveform_curves(np.array(irs))

    reference = mean_curves([run(40000)[1] for _ in range(2)])
    return sweep("pyroomacoustics", "rays", run, (1000, 5000, 20000), reference)


def at_equal_error(mine: list, theirs: list) -> None:
    """Print pairs per second of ours over theirs, ours interpolated (log-log) at their errors."""
    ordered = sorted((error, seconds) for seconds, error in mine)
    errors, seconds = np.log(np.array(ordered)).T
    for their_seconds, their_error in theirs:
        own = np.exp(np.interp(np.log(their_error), errors, seconds))
        beyond = not errors[0] <= np.log(their_error) <= errors[-1]
        print(
            f"  at {their_error:.2f} dB: {their_seconds / own:.0f} times"
            + (" (beyond the settings measured: ours at the nearest)" if beyond else "")
        )


def main() -> None:
    scene = ss.load_scene(HOUSE if HOUSE.is_dir() else "demo")
    grid, points = chosen_points(scene)
    _header(f"{scene.name}, {len(scene.faces)} triangles, {len(points)} points for ours")
    mine = ours(scene, grid, points, (250, 500, 1000))
    if importlib.util.find_spec("rlr_audio_propagation"):
        theirs = rlr(scene, points)
        print("pairs per second of ours over RLR's, at its error:")
        at_equal_error(mine, theirs)

    box = _shoebox()
    inner = np.random.default_rng(1).uniform(0.4, np.array(BOX) - 0.4, (100, 3))
    _header(f"shoebox, {len(inner)} points for ours")
    mine = ours(box, inner, inner, (250, 500))
    if importlib.util.find_spec("pyroomacoustics"):
        theirs = pyroomacoustics(inner)
        print("pairs per second of ours over pyroomacoustics', at its error:")
        at_equal_error(mine, theirs)


if __name__ == "__main__":
    main()
