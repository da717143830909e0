"""How much is known about a pair for how much time: this engine, SoundSpaces 2.0's, and pyroomacoustics.

Question: How many pairs per second does each program simulate at equal error?

Method: Per window and band, the relative error of the energy of one pair, and the efficiency 1 / (seconds per
ordered pair × relative variance), every program in the same run. Doubling the rays of a program doubles its
seconds and halves its variance, so a ratio of efficiencies is one of pairs per second at equal error, whatever
the error. The same pairs of points (those in sight apart from those that are not), mesh, materials, bands and
windows; variance over runs with random numbers of their own, not distance from a reference. Responses of
programs that give waveforms hold noise of their own, whose part of the variance, the sum of squared energies of
10 ms over (bandwidth × 10 ms) and over the square of their sum, is taken off. Ours at default settings; the
house as labelled and with one material (absorption .2, scattering .3), and a shoebox of that material for
pyroomacoustics, which does not take a mesh of this size. RLR gives one mono response per pair, pyroomacoustics
six listeners per call. A cell is empty where the runs do not tell the variance from what waveform noise adds. A
program that is not installed is left out.

Amortised: Ours computes all pairs of N points and makes the scene ready once: both are in its seconds, divided
by the ordered pairs, so that they are given for several N. The others gain nothing by other pairs; what they
prepare once is not counted.

Takes: 40 minutes. Arguments: runs (12), and N with commas (10,50,150). Needs ../shared, and the programs of
benchmarks/requirements.txt for comparison.
"""

from __future__ import annotations

import importlib.util
import itertools
import json
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass

import numba
import numpy as np
from scipy.signal import butter, sosfiltfilt

import soundspaces_sim as ss
from benchmarks.tools.record import Table, table
from benchmarks.tools.rlr import materials
from benchmarks.tools.scenes import (
    ABSORPTION,
    BOX,
    SCATTERING,
    house,
    one_material,
    shoebox,
    shuffled_points,
)
from soundspaces_sim.transport.integrator import simulate_tile
from soundspaces_sim.transport.preparation import make_model

MEASURES = ("core", "scene", "transport", "echogram")
RATE, BIN_S, LENGTH_S = 44100, 0.01, 0.8
EDGES = ss.SimulationConfig().bands
WINDOWS_S = ((0.0, 0.05), (0.05, 0.1), (0.1, 0.2), (0.2, 0.35))
OURS = "soundspaces_sim"
SIDE = 6  # sources, and listeners


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
        results.append(Result(OURS, f"N = {count}", seconds, np.array(energy), False))
    return results


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
            json.dump(materials(scene), file)
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


def _of_pairs(results: list[Result], title: str, name: str, pairs: np.ndarray) -> list[Table]:
    """Errors with efficiencies, and ours over the others', of some pairs."""
    windows = [f"{1e3 * a:.0f}–{1e3 * b:.0f} ms" for a, b in WINDOWS_S]
    rows: list[tuple[object, ...]] = []
    ratios: list[tuple[object, ...]] = []
    for band, (low, high) in enumerate(itertools.pairwise(EDGES)):
        hertz = f"{low:.0f} to {min(high, RATE / 2):.0f}"
        efficiency = {}
        for r in results:
            variance, error = (x[:, band] for x in r.variance(pairs))
            known = np.where(variance > 2.0 * error, variance, np.nan)
            efficiency[r.tool, r.setting] = 1.0 / (r.seconds * known)
            rows.append((hertz, r.tool, r.setting, 1e3 * r.seconds, *_known(np.sqrt(known))))
        for (tool, setting), theirs in efficiency.items():
            if tool != OURS:
                ratios += [
                    (hertz, f"{tool}, {setting}", count, *_known(own / theirs))
                    for (mine, count), own in efficiency.items()
                    if mine == OURS
                ]
    where = f"{title}; {pairs.sum()} pairs, {name}"
    heads = [("band", "Hz"), "program", "setting", ("per ordered pair", "ms"), *windows]
    tables = [table(f"{where}: relative error by window", heads, rows)]
    if ratios:
        over = f"{where}: pairs per second at equal error, ours over the other's"
        tables.append(table(over, [("band", "Hz"), "over", "ours at", *windows], ratios))
    return tables


def _known(values: np.ndarray) -> list[float | None]:
    return [float(v) if np.isfinite(v) else None for v in values]


def _report(title: str, results: list[Result], sight: np.ndarray) -> list[Table]:
    tables = []
    for name, pairs in (("all", np.ones_like(sight)), ("in sight", sight), ("out of sight", ~sight)):
        if pairs.sum() >= 2 and (name == "all" or not pairs.all()):
            tables += _of_pairs(results, title, name, pairs)
    return tables


def run(runs: str = "12", points: str = "10,50,150") -> list[Table]:
    """Errors, efficiencies and their ratios in three scenes."""
    counts, repeats = [int(n) for n in points.split(",")], int(runs)
    labelled = house()
    places = shuffled_points(labelled)
    if max(counts) > len(places):
        raise ValueError(f"{labelled.name}: expected at most {len(places)} points, got {points}")
    sight = in_sight(labelled, places)
    tables = []
    for title, scene in (("one material (.2, .3)", one_material(labelled)), ("as labelled", labelled)):
        results = ours(scene, places, counts, repeats)
        if importlib.util.find_spec("rlr_audio_propagation"):
            results += rlr(scene, places, (250, 1000), repeats)
        tables += _report(f"{labelled.name}, {len(scene.faces):,} triangles, {title}", results, sight)
    box = shoebox()
    inner = np.random.default_rng(1).uniform(0.4, np.array(BOX) - 0.4, (max(*counts, 2 * SIDE), 3))
    results = ours(box, inner, counts, repeats)
    if importlib.util.find_spec("pyroomacoustics"):
        results += pyroomacoustics(inner, (1000, 5000), repeats)
    return [*tables, *_report("shoebox 6 × 5 × 2.7 m (.2, .3)", results, np.ones(SIDE**2, bool))]
