"""How much is known about a pair for how much time: this engine and the others that pip installs.

Question: How many pairs per second does each program simulate at equal error?

Method: Per window and band, the relative error of the energy of one pair, and the efficiency 1 / (seconds per
ordered pair × relative variance), every program in the same run. Doubling the rays of a program doubles its
seconds and halves its variance, so a ratio of efficiencies is one of pairs per second at equal error, whatever
the error. Seconds are the processor's, one thread for every program. The same pairs of points (those in sight
apart from those that are not), mesh, materials, bands and windows; variance over runs with random numbers of
their own, not distance from a reference. Responses of programs that give waveforms hold noise of their own,
whose part of the variance, the sum of squared energies of 10 ms over (bandwidth × 10 ms) and over the square of
their sum, is taken off. Ours at default settings, and one source with four listeners as `simulate_many` has
them; the house as labelled and with one material (absorption .2, scattering .3), and a shoebox of that material.
What each program is asked for is in benchmarks/tools/programs. A cell is empty where the runs do not tell the
variance from what waveform noise adds. A program that is not installed is left out; a note names those that take
longer than a minute for a run (two where foretold), or do not end. Image sources alone have no variance: how far
their energies are from ours is told instead, in the box with its scattering, of which they know nothing, and
without.

Amortised: Ours computes all pairs of N points and makes the scene ready once: both are in its seconds, divided
by the ordered pairs, so that they are given for several N. The others gain nothing by other pairs, but for
listeners of one source; what they prepare once is not counted.

Takes: An hour and a half. Arguments: runs (12), and N with commas (10,50,150). Needs ../shared, and the programs
of benchmarks/requirements.txt for comparison; misuka is compiled where drjit finds LLVM 16 or later
(DRJIT_LIBLLVM_PATH).
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

import soundspaces_sim as ss
from benchmarks.tools import programs
from benchmarks.tools.energies import EDGES, LENGTH_S, RATE, WINDOWS_S, Result, of_echograms, of_window
from benchmarks.tools.programs import pyroomacoustics
from benchmarks.tools.record import Table, table
from benchmarks.tools.scenes import (
    ABSORPTION,
    BOX,
    SCATTERING,
    house,
    one_material,
    shoebox,
    shuffled_points,
)
from soundspaces_sim.core.numerics.kernel import set_thread_count, thread_count
from soundspaces_sim.transport.integrator import simulate_tile
from soundspaces_sim.transport.preparation import make_model

OURS = "soundspaces_sim"
SIDE = 6  # sources, and listeners
FEW = 4  # listeners of one source
IMAGE_ORDERS = (10, 17)


def ours(scene: ss.Scene, points: np.ndarray, counts: Sequence[int], runs: int) -> list[Result]:
    """Default settings; energies between the first SIDE and the next SIDE points, seconds for each N."""
    config = ss.SimulationConfig(duration=LENGTH_S)
    few = points[: 2 * SIDE]
    simulate_tile(make_model(scene, few[:2], config), few[:2], None)  # compile
    energy = []
    for seed in range(runs):
        echoes = simulate_tile(make_model(scene, few, config, seed), few[:SIDE], few[SIDE:], False)[0]
        energy.append(of_echograms(echoes))
    results = []
    for count in counts:
        start = time.process_time()
        simulate_tile(make_model(scene, points[:count], config, 1), points[:count], None)
        seconds = (time.process_time() - start) / count**2
        results.append(Result(OURS, f"N = {count}", seconds, np.array(energy), False))
    return results


def ours_few(scene: ss.Scene, ends: tuple[np.ndarray, np.ndarray], runs: int) -> Result:
    """Sources and listeners with preparation, as `simulate_many` has them."""
    config = ss.SimulationConfig(
        duration=LENGTH_S, radiance_transfer=ss.RadianceTransferConfig(subpaths="auto")
    )
    energy, seconds = [], []
    for seed in range(runs + 1):
        start = time.process_time()
        echoes = ss.simulate(scene, *ends, config, seed)
        seconds.append(time.process_time() - start)
        energy.append(of_echograms(echoes))
    # The first run reads what is kept on disk of a scene, and kernels.
    sources, listeners = (len(e) for e in ends)
    spent = float(np.mean(seconds[1:])) / (sources * listeners)
    return Result(OURS, f"{sources} × {listeners}", spent, np.array(energy[1:]), False)


def theirs(
    scene: ss.Scene, sources: np.ndarray, listeners: np.ndarray, runs: int
) -> tuple[list[Result], list[str]]:
    """Every installed program at each of its settings; and which of them took too long."""
    results, slow = [], []
    pairs = len(sources) * len(listeners)
    for name in programs.installed():
        program = programs.program(name)
        if program.BOXES_ONLY and len(scene.faces) != 12:
            continue
        seconds, last = 0.0, 1
        for setting in program.SETTINGS:  # in order: what follows takes no less
            named = f"{program.NAME} at {setting} {program.UNIT} for {pairs} pairs"
            if seconds * setting / last > 2.0 * programs.LIMIT_S:
                slow.append(f"{named}: a run would take {seconds * setting / last:.0f} s")
                break
            try:
                seconds, energy = programs.runs(name, scene, (sources, listeners), setting, runs)
            except programs.TooSlowError as error:
                slow.append(f"{named}: {error}")
                break
            last = setting
            found = f"{setting} {program.UNIT}", seconds / pairs, energy, program.WAVEFORMS
            results.append(Result(program.NAME, *found))
    return results, slow


def in_sight(scene: ss.Scene, points: np.ndarray) -> np.ndarray:
    """(SIDE²,) whether the direct sound of a pair crosses no wall."""
    config = ss.SimulationConfig(walks=16, duration=0.01)
    echoes = ss.simulate(scene, points[:SIDE], points[SIDE : 2 * SIDE], config)
    return np.asarray(echoes.walls).ravel() == 0


def _of_pairs(
    results: list[Result], title: str, name: str, pairs: np.ndarray, notes: str
) -> list[Table]:
    """Errors with efficiencies, and ours over the others', of some pairs."""
    windows = _windows()
    rows: list[tuple[object, ...]] = []
    ratios: list[tuple[object, ...]] = []
    for band, (low, high) in enumerate(itertools.pairwise(EDGES)):
        hertz = f"{low:.0f} to {min(high, RATE / 2):.0f}"
        efficiency = {}
        for r in results:
            variance, error = (x[:, band] for x in r.variance(pairs))
            known = np.where(variance > 2.0 * error, variance, np.nan)
            efficiency[r.program, r.setting] = 1.0 / (r.seconds * known)
            rows.append((hertz, r.program, r.setting, 1e3 * r.seconds, *_known(np.sqrt(known))))
        for (program, setting), other in efficiency.items():
            if program != OURS:
                ratios += [
                    (hertz, f"{program}, {setting}", count, *_known(own / other))
                    for (mine, count), own in efficiency.items()
                    if mine == OURS
                ]
    where = f"{title}; {pairs.sum()} pairs, {name}"
    heads = [("band", "Hz"), "program", "setting", ("per ordered pair", "ms"), *windows]
    tables = [table(f"{where}: relative error by window", heads, rows, notes)]
    if ratios:
        over = f"{where}: pairs per second at equal error, ours over the other's"
        tables.append(table(over, [("band", "Hz"), "over", "ours at", *windows], ratios))
    return tables


def _windows() -> list[str]:
    return [f"{1e3 * a:.0f}–{1e3 * b:.0f} ms" for a, b in WINDOWS_S]


def _known(values: np.ndarray) -> list[float | None]:
    return [float(v) if np.isfinite(v) else None for v in values]


def of_scene(
    title: str, scene: ss.Scene, points: np.ndarray, counts: Sequence[int], runs: int, sight: np.ndarray
) -> list[Table]:
    """SIDE × SIDE pairs, apart by sight, and one source with FEW listeners."""
    mine = ours(scene, points, counts, runs)
    others, slow = theirs(scene, points[:SIDE], points[SIDE : 2 * SIDE], runs)
    tables = []
    for name, pairs in (("all", np.ones_like(sight)), ("in sight", sight), ("out of sight", ~sight)):
        if pairs.sum() >= 2 and (name == "all" or not pairs.all()):
            tables += _of_pairs([*mine, *others], title, name, pairs, _left_out(slow))
    ends = points[:1], points[SIDE : SIDE + FEW]
    others, slow = theirs(scene, *ends, runs)
    same = [ours_few(scene, ends, runs)]
    same += [replace(r, energy=r.energy[:, :FEW]) for r in mine]
    every = np.ones(FEW, bool)
    name = f"one source and {FEW} listeners"
    return [*tables, *_of_pairs([*same, *others], title, name, every, _left_out(slow))]


def _left_out(slow: list[str]) -> str:
    return f"Left out: {'; '.join(slow)}." if slow else ""


def image_sources(points: np.ndarray, runs: int) -> list[Table]:
    """Image sources alone beside the mean of our runs, in the box with scattering and without."""
    if "pyroomacoustics" not in programs.installed():
        return []
    rows: list[tuple[object, ...]] = []
    for scattering in (SCATTERING, 0.0):
        scene = shoebox(scattering)
        ends = points[:SIDE], points[SIDE : 2 * SIDE]
        own = ours_few(scene, ends, runs)
        direct = ss.simulate(scene, *ends, ss.SimulationConfig(walks=16, duration=0.05)).direct_energy
        mean = own.energy.mean(axis=0)
        for order in IMAGE_ORDERS:
            simulate = pyroomacoustics.image_sources(scene, *ends, order)
            simulate(0)
            start = time.process_time()
            found = simulate(0)
            seconds = (time.process_time() - start) / SIDE**2
            energy = pyroomacoustics.energies(found)
            alone = pyroomacoustics.energies(pyroomacoustics.image_sources(scene, *ends, 0)(0)).sum(
                axis=1
            )
            energy *= (direct.reshape(SIDE**2, -1) / alone)[:, None]
            for band, (low, high) in enumerate(itertools.pairwise(EDGES)):
                level = [
                    np.array([of_window(e[None], w)[0, :, :, band].sum() for w in WINDOWS_S])
                    for e in (energy, mean)
                ]
                off = [10.0 * float(np.log10(r)) if r > 1e-3 else None for r in level[0] / level[1]]
                hertz = f"{low:.0f} to {min(high, RATE / 2):.0f}"
                rows.append((scattering, order, hertz, 1e3 * seconds, 1e3 * own.seconds, *off))
    heads: list[str | tuple[str, str]] = ["scattering", "order", ("band", "Hz")]
    heads += [("theirs per pair", "ms"), ("ours per pair", "ms"), *_windows()]
    title = f"shoebox: image sources alone over the mean of our runs, dB, {SIDE**2} pairs, direct sound alike"
    note = "Empty cells: less than a thousandth. Image sources add pressures, whose interference these sums hold."
    return [table(title, heads, rows, note)]


def run(runs: str = "12", points: str = "10,50,150") -> list[Table]:
    """Errors, efficiencies and their ratios in three scenes."""
    counts, repeats = [int(n) for n in points.split(",")], int(runs)
    labelled = house()
    places = shuffled_points(labelled)
    if max(counts) > len(places):
        raise ValueError(f"{labelled.name}: expected at most {len(places)} points, got {points}")
    sight = in_sight(labelled, places)
    inner = np.random.default_rng(1).uniform(0.4, np.array(BOX) - 0.4, (max(*counts, 2 * SIDE), 3))
    of_house = f"{labelled.name}, {len(labelled.faces):,} triangles"
    of_box = f"shoebox {BOX[0]:.0f} × {BOX[1]:.0f} × {BOX[2]} m ({ABSORPTION}, {SCATTERING})"
    tables = []
    before = thread_count()
    set_thread_count(1)
    try:
        for title, scene in (("one material", one_material(labelled)), ("as labelled", labelled)):
            tables += of_scene(f"{of_house}, {title}", scene, places, counts, repeats, sight)
        every = np.ones(SIDE**2, bool)
        tables += of_scene(of_box, shoebox(), inner, counts, repeats, every)
        return [*tables, *image_sources(inner, repeats)]
    finally:
        set_thread_count(before)
