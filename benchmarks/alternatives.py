"""How much is known about a pair for how much time: this engine, SoundSpaces 2.0's, and pyroomacoustics.

    .venv/bin/python -m pip install -r benchmarks/requirements.txt
    .venv/bin/python -m benchmarks.alternatives [--runs 12] [--points 10,50,150]

Prints, per window and octave-wide band, the relative error of the energy of one pair and the efficiency

    1 / (seconds per pair × relative variance)

of every tool, all in one run, and the ratios of efficiencies. Doubling the rays of a tool doubles its seconds and
halves its variance, so a ratio of efficiencies is one of pairs per second at equal error, whatever the error.

What is fair and how: the same pairs of points (those in sight apart from those that are not), the same mesh,
materials, bands and windows; variance over runs with random numbers of their own, not distance from a
reference; RIRs of tools that give waveforms hold noise of their own, whose part of the variance, the
sum of squared energies of 10 ms over (bandwidth × 10 ms) and over the square of their sum, is taken off; a pair is
two directions for us, and one for them, so that their seconds are per ordered pair and so are ours. Ours computes
all pairs of N points, so its seconds per pair hang on N and are given for several; the others gain nothing by
other pairs. Ours counts what it does once per scene too, divided by the ordered pairs.

The house is ../shared's, as labelled and with one material (absorption .2, scattering .3); the demo scene where
that is absent. The shoebox (6 × 5 × 2.7 m, the same material) is for pyroomacoustics, which does not take a mesh of
this size. A tool that is not installed is left out.
"""

from __future__ import annotations

import argparse
import importlib.util
import itertools
import json
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass

import numba
import numpy as np
import trimesh
from scipy.signal import butter, sosfiltfilt

import soundspaces_sim as ss
from benchmarks.engine import HOUSE
from soundspaces_sim.transport.integrator import simulate_tile
from soundspaces_sim.transport.preparation import make_model

RATE, BIN_S, LENGTH_S = 44100, 0.01, 0.8
EDGES = ss.SimulationConfig().bands
WINDOWS_S = ((0.0, 0.05), (0.05, 0.1), (0.1, 0.2), (0.2, 0.35))
SIDE = 6  # sources, and listeners
BOX = (6.0, 5.0, 2.7)
ABSORPTION, SCATTERING = 0.2, 0.3


@dataclass(frozen=True)
class Result:
    """What a tool says of the pairs."""

    tool: str
    setting: str
    seconds: float  # per ordered pair
    energy: np.ndarray  # (runs, pairs, bins of 10 ms, bands)
    waveforms: bool  # the energies are those of noise

    def variance(self, pairs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(windows, bands) mean relative variance of some pairs, less waveform noise; its standard error."""
        out, error = np.empty((2, len(WINDOWS_S), self.energy.shape[3]))
        width = np.diff(np.minimum(EDGES, 0.5 * RATE))
        runs = len(self.energy)
        for w, (low, high) in enumerate(WINDOWS_S):
            bins = self.energy[:, pairs, round(low / BIN_S) : round(high / BIN_S)]
            total = bins.sum(axis=2)
            mean = total.mean(axis=0)
            own = total.var(axis=0, ddof=1) / mean**2
            if self.waveforms:
                # Squared values of single runs are too large by their own noise: E[x²] = m² (1 + 1 / (B t)).
                noise = (bins**2).mean(axis=0).sum(axis=1) / (1.0 + 1.0 / (width * BIN_S))
                own = own - noise / (width * BIN_S) / mean**2
            out[w] = own.mean(axis=0)
            error[w] = own.std(axis=0, ddof=1) / np.sqrt(own.shape[0]) + out[w] * np.sqrt(
                2.0 / (runs - 1) / own.shape[0]
            )
        return out, error


def chosen_points(scene: ss.Scene) -> np.ndarray:
    """All grid points, the 2 SIDE of the comparison first."""
    grid = ss.make_grid(scene, 1.0).points
    return np.asarray(grid[np.random.default_rng(0).permutation(len(grid))])


def echogram_energies(echoes: ss.Echograms) -> np.ndarray:
    """(pairs, bins, bands) energies in steps of 10 ms."""
    bins = round(LENGTH_S / BIN_S)
    out = np.zeros((len(echoes), bins, len(EDGES) - 1))
    rows = np.minimum((echoes.time_edges[:-1] / BIN_S + 1e-9).astype(int), bins - 1)
    np.add.at(out, (slice(None), rows), echoes.energy[..., 0, :].reshape(len(echoes), len(rows), -1))
    at = np.minimum((echoes.direct_length / echoes.speed_of_sound / BIN_S).astype(int), bins - 1)
    np.add.at(out, (np.arange(len(echoes)), at.ravel()), echoes.direct_energy.reshape(len(echoes), -1))
    pair = np.repeat(np.arange(len(echoes)), np.diff(echoes.early_start))
    at = np.minimum((echoes.early.delay / BIN_S).astype(int), bins - 1)
    np.add.at(out, (pair, at), echoes.early.energy)
    return out


def waveform_energies(irs: np.ndarray) -> np.ndarray:
    """The same of (pairs, samples) responses."""
    bins = round(LENGTH_S / BIN_S)
    out = np.empty((len(irs), bins, len(EDGES) - 1))
    for b, (low, high) in enumerate(itertools.pairwise(EDGES)):
        sos = butter(4, [max(low, 20.0), min(high, 0.49 * RATE)], "bandpass", fs=RATE, output="sos")
        band = sosfiltfilt(sos, irs, axis=1)[:, : round(LENGTH_S * RATE)] ** 2
        out[:, :, b] = np.add.reduceat(band, np.arange(bins) * round(BIN_S * RATE), axis=1)
    return out


def ours(scene: ss.Scene, points: np.ndarray, counts: Sequence[int], runs: int) -> list[Result]:
    """Default settings; energies between the first SIDE and the next SIDE points, seconds for each N."""
    config = ss.SimulationConfig(duration=LENGTH_S)
    few = points[: 2 * SIDE]
    simulate_tile(make_model(scene, few[:2], config), few[:2], None)  # compile
    energy = []
    for seed in range(runs):
        echoes = simulate_tile(make_model(scene, few, config, seed), few[:SIDE], few[SIDE:], False)[0]
        energy.append(echogram_energies(echoes))
    results = []
    for count in counts:
        start = time.perf_counter()
        simulate_tile(make_model(scene, points[:count], config, 1), points[:count], None)
        seconds = (time.perf_counter() - start) / count**2
        results.append(Result("soundspaces_sim", f"N = {count}", seconds, np.array(energy), False))
    return results


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


def rlr(scene: ss.Scene, points: np.ndarray, settings: Sequence[int], runs: int) -> list[Result]:
    """SoundSpaces 2.0's engine, Y up; its default is 5000 rays. One mono response per pair, its fastest way."""
    import rlr_audio_propagation as rlr_module

    results = []
    for rays in settings:
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
        context.add_listener(rlr_module.ChannelLayout(rlr_module.ChannelLayoutType.Mono, 1))
        energy, seconds = [], 0.0
        for _ in range(runs):
            irs = []
            for source, listener in itertools.product(points[:SIDE], points[SIDE : 2 * SIDE]):
                context.set_source_position(0, [source[0], source[2], -source[1]])
                context.set_listener_position(0, [listener[0], listener[2], -listener[1]])
                start = time.perf_counter()
                context.simulate()
                seconds += time.perf_counter() - start
                irs.append(_fitted(np.array(context.get_ir_channel(0, 0, 0))))
            energy.append(waveform_energies(np.array(irs)))
        results.append(
            Result(
                "rlr-audio-propagation", f"{rays} rays", seconds / runs / SIDE**2, np.array(energy), True
            )
        )
    return results


def _fitted(ir: np.ndarray) -> np.ndarray:
    samples = round(LENGTH_S * RATE)
    return np.pad(ir[:samples], (0, max(samples - len(ir), 0)))


def shoebox() -> ss.Scene:
    mesh = trimesh.creation.box(extents=BOX)
    materials = ss.MaterialTable(["wall"], [1000.0], [[ABSORPTION]], [[SCATTERING]], [[0.0]])
    zeros = np.zeros(len(mesh.faces), int)
    return ss.Scene(mesh.vertices + np.array(BOX) / 2.0, mesh.faces, zeros, materials, name="shoebox")


def pyroomacoustics(points: np.ndarray, settings: Sequence[int], runs: int) -> list[Result]:
    """Image sources to order 3, ray tracing beyond; all listeners in one call, its fastest way."""
    import pyroomacoustics as pra

    results = []
    for rays in settings:
        energy, seconds = [], 0.0
        for _ in range(runs):
            irs = []
            for source in points[:SIDE]:
                material = pra.Material(energy_absorption=ABSORPTION, scattering=SCATTERING)
                room = pra.ShoeBox(
                    BOX, fs=RATE, materials=material, max_order=3, ray_tracing=True, air_absorption=True
                )
                room.set_ray_tracing(n_rays=rays, hist_bin_size=0.004)
                room.add_source(source)
                room.add_microphone_array(points[SIDE : 2 * SIDE].T)
                start = time.perf_counter()
                room.compute_rir()
                seconds += time.perf_counter() - start
                irs += [_fitted(np.asarray(row[0])) for row in room.rir]
            energy.append(waveform_energies(np.array(irs)))
        results.append(
            Result("pyroomacoustics", f"{rays} rays", seconds / runs / SIDE**2, np.array(energy), True)
        )
    return results


def in_sight(scene: ss.Scene, points: np.ndarray) -> np.ndarray:
    """(SIDE²,) whether the direct sound of a pair crosses no wall."""
    config = ss.SimulationConfig(walks=16, duration=0.01)
    echoes = ss.simulate(scene, points[:SIDE], points[SIDE : 2 * SIDE], config)
    return np.asarray(echoes.walls).ravel() == 0


def _columns(values: np.ndarray, form: str) -> str:
    return "".join(" " * 9 if not np.isfinite(v) else f"{v:9{form}}" for v in values)


def report(title: str, results: list[Result], sight: np.ndarray) -> None:
    """Print errors and efficiencies, and those of ours over the others', for pairs in sight and out of sight."""
    print(f"\n{title}; windows of {', '.join(f'{1e3 * a:.0f}-{1e3 * b:.0f}' for a, b in WINDOWS_S)} ms")
    for name, pairs in (("all", np.ones_like(sight)), ("in sight", sight), ("out of sight", ~sight)):
        if pairs.sum() < 2 or (name != "all" and pairs.all()):
            continue
        print(f"{pairs.sum()} pairs, {name}")
        for band, (low, high) in enumerate(itertools.pairwise(EDGES)):
            print(f"  {low:.0f} to {min(high, RATE / 2):.0f} Hz")
            efficiency = {}
            for r in results:
                variance, error = (x[:, band] for x in r.variance(pairs))
                known = np.where(variance > 2.0 * error, variance, np.nan)
                efficiency[r.tool, r.setting] = 1.0 / (r.seconds * known)
                errors, own = (
                    _columns(np.sqrt(known), ".3f"),
                    _columns(efficiency[r.tool, r.setting], ".0f"),
                )
                print(
                    f"    {r.tool:<22s}{r.setting:<11s}{1e3 * r.seconds:9.2f} ms  error{errors}   efficiency{own}"
                )
            for (tool, setting), theirs in efficiency.items():
                if tool == "soundspaces_sim":
                    continue
                for (mine, count), own in efficiency.items():
                    if mine == "soundspaces_sim":
                        print(
                            f"    ours at {count} over {tool} at {setting:<11s}{_columns(own / theirs, '.0f')}"
                        )


def one_material(scene: ss.Scene) -> ss.Scene:
    table = ss.MaterialTable(["any"], [1000.0], [[ABSORPTION]], [[SCATTERING]], [[0.0]])
    return ss.Scene(scene.vertices, scene.faces, np.zeros(len(scene.faces), int), table, name=scene.name)


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--runs", type=int, default=12)
    parser.add_argument("--points", default="10,50,150", help="N of ours, with commas")
    given = parser.parse_args(arguments)
    counts = [int(n) for n in given.points.split(",")]

    labelled = ss.load_scene(HOUSE if HOUSE.is_dir() else "demo")
    points = chosen_points(labelled)
    sight = in_sight(labelled, points)
    for title, scene in (("one material", one_material(labelled)), ("as labelled", labelled)):
        results = ours(scene, points, [n for n in counts if n <= len(points)], given.runs)
        if importlib.util.find_spec("rlr_audio_propagation"):
            results += rlr(scene, points, (250, 1000), given.runs)
        report(f"{labelled.name}, {len(scene.faces)} triangles, {title}", results, sight)

    box = shoebox()
    inner = np.random.default_rng(1).uniform(0.4, np.array(BOX) - 0.4, (max(*counts, 2 * SIDE), 3))
    results = ours(box, inner, counts, given.runs)
    if importlib.util.find_spec("pyroomacoustics"):
        results += pyroomacoustics(inner, (1000, 5000), given.runs)
    report("shoebox", results, np.ones(SIDE**2, bool))


if __name__ == "__main__":
    main()
