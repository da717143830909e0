"""The genuine rlr_audio_propagation beside `soundspaces_sim.rlr`: what both hear, and seconds per `simulate`.

    .venv/bin/python -m pip install rlr-audio-propagation==0.0.1    # non-commercial use only
    .venv/bin/python -m benchmarks.rlr [example] [box] [house] [speed] [moves]

The same calls go to both. Differences are means over pairs of ours less theirs, with standard errors over the
pairs (of both engines' noise); both at their defaults, so in one thread. The error that speed is compared at is
that of the energy in windows of time in the band 775 to 3409 Hz, over runs with fresh noise, less what the
noise of a waveform alone makes of it, 1 / (bandwidth * window) in relative variance. Seconds are the processor's,
which others on the machine do not change; on an idle core one thread takes as long by the clock.
"""

from __future__ import annotations

import importlib.metadata
import itertools
import json
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from types import ModuleType
from typing import Any
from unittest.mock import patch

import numpy as np
import trimesh

import soundspaces_sim as ss
from benchmarks.alternatives import BOX, _rlr_materials
from benchmarks.engine import HOUSE
from soundspaces_sim.echogram.filters import band_windows
from soundspaces_sim.echogram.measures import reverberation_times, waveform_measures
from soundspaces_sim.rlr import api, propagation

PARTS = ("example", "box", "house", "speed", "moves")
RATE, LENGTH_S = 44100, 1.0
OCTAVES = (125, 250, 500, 1000, 2000, 4000, 8000)
EDGES = (0.0, *(f / np.sqrt(2.0) for f in (*OCTAVES, 16000)))
WINDOWS_S = (0.0, 0.05, 0.1, 0.2, 0.35)
LOW, HIGH = 775.0, 3409.0
OUR_RAYS, THEIR_RAYS = (312, 1250, 5000, 20000), (250, 1000, 5000)  # ascending
SPEED = ss.SimulationConfig().c


def context(module: ModuleType, scene: ss.Scene, rays: int = 5000, **settings: Any) -> Any:
    """A context of either engine with the scene in it."""
    config = module.Config()
    config.max_ir_length, config.sample_rate = LENGTH_S, float(RATE)
    config.indirect_ray_count = rays
    for name, value in settings.items():
        setattr(config, name, value)
    made = module.Context(config)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "materials.json")
        path.write_text(json.dumps(_rlr_materials(scene)))
        made.set_material_database_json(str(path))
    made.add_object()
    made.add_mesh_vertices(scene.vertices.ravel().tolist())
    for i, name in enumerate(scene.materials.names):
        faces = scene.faces[scene.face_material == i]
        if len(faces):
            made.add_mesh_indices(faces.ravel().tolist(), 3, name)
    made.finalize_object_mesh(0)
    return made


def populate(module: ModuleType, made: Any, sources: np.ndarray, listeners: np.ndarray) -> None:
    """Sources and mono listeners at (S, 3) and (L, 3)."""
    made.clear_sources()
    made.clear_listeners()
    for i, point in enumerate(sources):
        made.add_source()
        made.set_source_position(i, point.tolist())
    for i, point in enumerate(listeners):
        made.add_listener(module.ChannelLayout(module.ChannelLayoutType.Mono, 1))
        made.set_listener_position(i, point.tolist())


def responses(made: Any, sources: int, listeners: int) -> np.ndarray:
    """(S * L, n) of the last simulation."""
    n = round(LENGTH_S * RATE)
    out = np.zeros((sources * listeners, n))
    for k, (s, l) in enumerate(itertools.product(range(sources), range(listeners))):
        row = np.asarray(made.get_ir_channel(l, s, 0))[:n]
        out[k, : len(row)] = row
    return out


def octave_measures(irs: np.ndarray) -> dict[str, np.ndarray]:
    """Level in dB, EDT and T30 in s, each (k, octaves)."""
    n = 2 * irs.shape[1]
    gains = band_windows(EDGES, np.fft.rfftfreq(n, 1.0 / RATE), RATE)[1:]
    energy = np.array([[(np.abs(np.fft.rfft(ir, n)) ** 2 * g).sum() for g in gains] for ir in irs])
    found = [waveform_measures(ir, RATE, EDGES) for ir in irs]
    return {
        "level": 10.0 * np.log10(energy),
        "EDT": np.array([m.edt[1:] for m in found]),
        "T30": np.array([m.t30[1:] for m in found]),
    }


def compare(
    module: ModuleType, name: str, scene: ss.Scene, sources: np.ndarray, listeners: np.ndarray, runs: int,
    **settings: Any,
) -> None:  # fmt: skip
    """Print differences per octave, ours less theirs; `runs` simulations of each are averaged per pair."""
    found = []
    for each in (api, module):
        made = context(each, scene, **settings)
        populate(each, made, sources, listeners)
        measured = []
        for run in range(runs):
            with patch.object(propagation, "SEED", run):
                made.simulate()
            measured.append(octave_measures(responses(made, len(sources), len(listeners))))
        found.append({key: np.nanmean([m[key] for m in measured], axis=0) for key in measured[0]})
    ours, theirs = found
    pairs = len(sources) * len(listeners)
    print(f"\n{name}: ours less theirs over {pairs} pairs, {runs} runs of each")
    print(f"{'octave Hz':<22s}" + "".join(f"{f:>13d}" for f in OCTAVES))
    for key in ours:
        scale = 1.0 if key == "level" else 100.0 / np.nanmean(theirs[key], axis=0)
        off = (ours[key] - theirs[key]) * scale
        mean, error = np.nanmean(off, axis=0), np.nanstd(off, axis=0, ddof=1) / np.sqrt(pairs)
        unit = "dB" if key == "level" else "%"
        print(
            f"{key + ', ' + unit:<22s}"
            + "".join(f"{m:+7.2f} ± {e:.2f}" for m, e in zip(mean, error, strict=True))
        )
        if key != "level":
            for who, values in (("ours", ours), ("theirs", theirs)):
                row = np.nanmean(values[key], axis=0)
                print(f"{'  ' + who + ', s':<22s}" + "".join(f"{v:13.3f}" for v in row))


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


def early_against_integral(
    module: ModuleType, sources: np.ndarray, listeners: np.ndarray, runs: int
) -> None:
    """Print what both give, over the integral, where walls absorb 0.95 and scatter the rest."""
    absorption = 0.95
    scene = _box_of(absorption, 1.0)
    exact = np.array([first_reflection(s, l, absorption) for s in sources for l in listeners])
    print(
        f"\nreflections in the box, absorption {absorption}, scattering 1, over the integral of the first"
    )
    for who, each in (("ours", api), ("theirs", module)):
        made = context(each, scene, direct=0)
        populate(each, made, sources, listeners)
        ratios = []
        for run in range(runs):
            with patch.object(propagation, "SEED", run):
                made.simulate()
            irs = responses(made, len(sources), len(listeners))
            spectrum = np.abs(np.fft.rfft(irs, axis=1)) ** 2
            frequency = np.fft.rfftfreq(irs.shape[1], 1.0 / RATE)
            ratios.append(spectrum[:, (frequency > LOW) & (frequency < HIGH)].mean(axis=1) / exact)
        values = np.array(ratios).mean(axis=1)
        print(f"{who:<10s}{values.mean():6.3f} ± {values.std(ddof=1) / np.sqrt(runs):.3f}")


def reflections_by_absorption(
    module: ModuleType, sources: np.ndarray, listeners: np.ndarray, runs: int
) -> None:
    """Print how much louder theirs are where walls scatter all they reflect: the less walls absorb, the more of the
    energy has been reflected often."""
    print("\nreflections in the box, scattering 1: theirs over ours, dB per octave")
    print(f"{'absorption':<12s}" + "".join(f"{f:>8d}" for f in OCTAVES))
    for absorption in (0.95, 0.5, 0.2):
        levels = []
        for each in (api, module):
            made = context(each, _box_of(absorption, 1.0), direct=0)
            populate(each, made, sources, listeners)
            energy = np.zeros(len(OCTAVES))
            for run in range(runs):
                with patch.object(propagation, "SEED", run):
                    made.simulate()
                found = octave_measures(responses(made, len(sources), len(listeners)))["level"]
                energy += (10.0 ** (found / 10.0)).sum(axis=0)
            levels.append(10.0 * np.log10(energy))
        print(f"{absorption:<12}" + "".join(f"{d:8.2f}" for d in levels[1] - levels[0]), flush=True)


def decay_by_what_takes_it(module: ModuleType, sources: np.ndarray, listeners: np.ndarray) -> None:
    """Print T30 of the box whose thin walls reflect 0.7 and absorb the rest, or let two thirds through: nothing
    is outside, so what goes through is lost, and the decay is the same."""
    print("\nT30 in s, box, scattering 1: walls that reflect 0.7, into the open")
    print(f"{'absorbed, let through':<28s}" + "".join(f"{f:>8d}" for f in OCTAVES))
    for (absorption, through), (who, each) in itertools.product(
        ((0.3, 0.0), (0.1, 0.2)), (("ours", api), ("theirs", module))
    ):
        made = context(each, _box_of(absorption, 1.0, through=through))
        populate(each, made, sources, listeners)
        made.simulate()
        found = octave_measures(responses(made, len(sources), len(listeners)))["T30"]
        name = f"{absorption}, {through}"
        print(f"{name:<12s}{who:<16s}" + "".join(f"{t:8.2f}" for t in np.nanmean(found, axis=0)))


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


def decay_against_images(module: ModuleType, sources: np.ndarray, listeners: np.ndarray) -> None:
    """Print T30 of the box with a soft ceiling by scattering coefficient; without scattering image sources tell."""
    hard, soft = 0.1, 0.7
    energy = [image_decay(s, l, hard, soft) for s in sources for l in listeners]
    exact = np.mean([reverberation_times(e, 0.001, -5.0, -35.0)[0] for e in energy])
    print(
        f"\nT30 in s, box of absorption {hard}, ceiling {soft}, without air, by image sources: {exact:.2f}"
    )
    print(f"{'scattering':<22s}" + "".join(f"{f:>8d}" for f in OCTAVES))
    for scattering, (who, each) in itertools.product(
        (0.0, 0.1, 0.3, 1.0), (("ours", api), ("theirs", module))
    ):
        made = context(each, _box_of(hard, scattering, soft))
        populate(each, made, sources, listeners)
        made.simulate()
        found = octave_measures(responses(made, len(sources), len(listeners)))["T30"]
        print(f"{scattering:<6}{who:<16s}" + "".join(f"{t:8.2f}" for t in np.nanmean(found, axis=0)))


def air(module: ModuleType) -> None:
    """Print what 100 m of air take from the direct sound, beyond the spreading, dB per octave."""
    print("\nair, dB per 100 m" + "".join(f"{f:>8d}" for f in OCTAVES))
    for who, each in (("ours", api), ("theirs", module)):
        config = each.Config()
        config.sample_rate = float(RATE)
        made = each.Context(config)
        levels = []
        for distance in (10.0, 110.0):
            populate(each, made, np.array([[distance, 0.0, 0.0]]), np.zeros((1, 3)))
            made.simulate()
            levels.append(octave_measures(responses(made, 1, 1))["level"][0])
        lost = levels[0] - levels[1] - 20.0 * np.log10(11.0)
        print(f"{who:<17s}" + "".join(f"{d:8.2f}" for d in lost))


def window_energies(irs: np.ndarray, onset: np.ndarray) -> np.ndarray:
    """(k, windows) energy of the band in windows of time after the direct sound's time (k,) in s."""
    n = 2 * irs.shape[1]
    frequency = np.fft.rfftfreq(n, 1.0 / RATE)
    gain = np.sqrt(band_windows((0.0, LOW, HIGH, 20000.0), frequency, RATE)[1])
    band = np.fft.irfft(np.fft.rfft(irs, n, axis=1) * gain, n, axis=1)[:, : irs.shape[1]] ** 2
    total = np.concatenate([np.zeros((len(irs), 1)), band.cumsum(axis=1)], axis=1)
    cuts = np.rint((onset[:, None] + np.array(WINDOWS_S)) * RATE).astype(int)
    return np.asarray(np.diff(np.take_along_axis(total, cuts, axis=1), axis=1))


def errors(
    module: ModuleType, made: Any, sources: np.ndarray, listeners: np.ndarray, runs: int
) -> np.ndarray:
    """(windows,) relative error of energies over runs with fresh noise."""
    populate(module, made, sources, listeners)
    offsets = (sources[:, None] - listeners[None]).reshape(-1, 3)
    onset = np.linalg.norm(offsets, axis=1) / SPEED
    energies = []
    for run in range(runs):
        with patch.object(propagation, "SEED", 1 + run):
            made.simulate()
        energies.append(window_energies(responses(made, len(sources), len(listeners)), onset))
    values = np.array(energies)
    spread = (values.var(axis=0, ddof=1) / values.mean(axis=0) ** 2).mean(axis=0)
    noise = 1.0 / ((HIGH - LOW) * np.diff(WINDOWS_S))
    return np.sqrt(np.maximum(spread - noise, 1e-6))


def seconds(
    module: ModuleType,
    made: Any,
    sources: np.ndarray,
    listeners: np.ndarray,
    runs: int,
    enough: float = 60.0,
) -> float:
    """Median of the processor's seconds in `simulate`, of `runs`, or fewer if they take longer than `enough` s
    together; what is prepared once has been."""
    populate(module, made, sources, listeners)
    found: list[float] = []
    while len(found) < runs and sum(found) < enough:
        start = time.process_time()
        made.simulate()
        found.append(time.process_time() - start)
    return float(np.median(found))


def speed(
    module: ModuleType, scene: ss.Scene, cases: Sequence[tuple[str, np.ndarray, np.ndarray]], runs: int
) -> None:
    """Print errors, seconds per simulate of every case, and theirs over ours at their error; errors are those of
    the second case, for a pair's error does not hang on how many pairs there are."""
    windows = [f"{round(a * 1e3)}-{round(b * 1e3)} ms" for a, b in itertools.pairwise(WINDOWS_S)]
    names = [name for name, _, _ in cases]
    print("\nrelative error of energies, waveform noise taken off; processor's seconds per simulate")
    print(
        f"{'engine':<8s}{'rays':>6s}"
        + "".join(f"{w:>12s}" for w in windows)
        + "".join(f"{n:>9s}" for n in names)
    )
    rows: dict[str, list[tuple[int, np.ndarray, np.ndarray]]] = {"ours": [], "theirs": []}
    for who, each, rays in [("ours", api, n) for n in OUR_RAYS] + [
        ("theirs", module, n) for n in THEIR_RAYS
    ]:
        made = context(each, scene, rays)
        error = errors(each, made, cases[1][1], cases[1][2], runs)
        times = np.array([seconds(each, made, a, b, 3) for _, a, b in cases])
        rows[who].append((rays, error, times))
        print(f"{who:<8s}{rays:>6d}" + "".join(f"{e:12.3f}" for e in error) + "".join(f"{t:9.3f}" for t in times),
              flush=True)  # fmt: skip
    for rays, error, times in rows["theirs"]:
        print(f"theirs over ours at the error of their {rays} rays, by window:")
        for k, name in enumerate(names):
            ratios = []
            for w in range(len(windows)):
                known = np.log([(e[w], t[k]) for _, e, t in rows["ours"]][::-1])
                own = np.exp(np.interp(np.log(error[w]), known[:, 0], known[:, 1]))
                beyond = not known[0, 0] <= np.log(error[w]) <= known[-1, 0]
                ratios.append(f"{times[k] / own:.1f}" + ("*" if beyond else ""))
            print(f"  {name:<8s}" + " ".join(f"{r:>7s}" for r in ratios))
    print("* beyond the settings measured: ours at the nearest")


def moves(module: ModuleType, scene: ss.Scene, points: np.ndarray, runs: int) -> None:
    """Print the processor's seconds of `simulate` for one pair: the first, one of the same scene, one after a box
    of .6 m has moved; medians over `runs` contexts. Ours must give the bits of a context made afresh."""

    def furnished(each: ModuleType, place: np.ndarray) -> Any:
        made = context(each, scene)
        made.add_object()
        made.set_object_box(1, [-0.3] * 3, [0.3] * 3, each.BoxMaterialCategories())
        made.set_object_position(1, place.tolist())
        populate(each, made, points[:1], points[1:2])
        return made

    def timed(made: Any) -> float:
        start = time.process_time()
        made.simulate()
        return time.process_time() - start

    print("\nseconds of the processor per simulate, one pair")
    print(f"{'engine':<8s}{'first':>9s}{'again':>9s}{'moved':>9s}")
    for who, each in (("ours", api), ("theirs", module)):
        rows = []
        for k in range(runs):
            places = points[2 + 2 * k : 4 + 2 * k]
            made = furnished(each, places[0])
            row = [timed(made), timed(made)]
            made.set_object_position(1, places[1].tolist())
            rows.append([*row, timed(made)])
            if each is api:
                fresh = furnished(each, places[1])
                fresh.simulate()
                same = np.array_equal(responses(made, 1, 1), responses(fresh, 1, 1))
                assert same, "a moved object left something behind"
        print(f"{who:<8s}" + "".join(f"{s:9.3f}" for s in np.median(rows, axis=0)), flush=True)


def example(module: ModuleType) -> None:
    """Run the example of docs/rlr.md as it is printed there, under either package."""
    page = (Path(__file__).parents[1] / "docs" / "rlr.md").read_text("utf-8")
    code = next(
        block.partition("```")[0]
        for block in page.split("```python\n")[1:]
        if block.startswith("from rlr_audio_propagation import")
    )
    print("\nthe example of docs/rlr.md: shape of get_audio()")
    for who, each in (("ours", api), ("theirs", module)):
        print(f"{who:<8s}", end="", flush=True)
        sys.modules["rlr_audio_propagation"] = each
        try:
            exec(code, {"__name__": "example"})
        finally:
            sys.modules["rlr_audio_propagation"] = module


def _box_of(
    absorption: float, scattering: float, ceiling: float | None = None, through: float = 0.0
) -> ss.Scene:
    """The box with walls alike, and another absorption above; `through`: transmission."""
    mesh = trimesh.creation.box(bounds=[np.zeros(3), BOX])
    upper = (mesh.triangles_center[:, 2] > BOX[2] - 1e-6).astype(int)
    above = absorption if ceiling is None else ceiling
    columns = ([1000.0], [[absorption], [above]], [[scattering]] * 2, [[through]] * 2)
    table = ss.MaterialTable(("wall", "lid"), *(np.array(column) for column in columns))
    return ss.Scene(mesh.vertices, mesh.faces, upper, table, name="box")


def _diffuse(scene: ss.Scene) -> ss.Scene:
    """The scene with walls that scatter all they reflect."""
    table = scene.materials
    ones = np.ones_like(table.scattering)
    diffuse = ss.MaterialTable(
        table.names, table.frequency_hz, table.absorption, ones, table.transmission
    )
    return ss.Scene(
        scene.vertices, scene.faces, scene.face_material, diffuse, name=f"{scene.name}, scattering 1"
    )


def main(parts: Sequence[str] = PARTS) -> None:
    """Print these parts."""
    try:
        version = importlib.metadata.version("rlr_audio_propagation")
    except importlib.metadata.PackageNotFoundError:
        print("rlr_audio_propagation is not installed: nothing to compare with")
        return
    if "+" in version:
        sys.exit(f"rlr_audio_propagation {version} is this package's own; install the genuine 0.0.1")
    import rlr_audio_propagation as genuine

    if "example" in parts:
        example(genuine)
    house = ss.load_scene(HOUSE if HOUSE.is_dir() else "demo")
    grid = ss.make_grid(house, 1.0).points
    points = grid[np.random.default_rng(0).permutation(len(grid))]
    if "box" in parts:
        places = np.random.default_rng(0).uniform(0.5, np.array(BOX) - 0.5, (10, 3))
        early_against_integral(genuine, places[:4], places[4:], 12)
        reflections_by_absorption(genuine, places[:2], places[4:8], 2)
        decay_by_what_takes_it(genuine, places[:2], places[4:8])
        air(genuine)
        decay_against_images(genuine, places[:2], places[4:8])
        for scattering in (1.0, 0.3):
            name = f"box 6 × 5 × 2.7 m, absorption .2, scattering {scattering}"
            compare(genuine, name, _box_of(0.2, scattering), places[:4], places[4:], 3)
    if "house" in parts:
        ends = points[:4], points[4:10]
        diffuse = _diffuse(house)
        compare(genuine, f"{diffuse.name}, no transmission", diffuse, *ends, 2, transmission=0)
        compare(genuine, diffuse.name, diffuse, *ends, 2)
        compare(genuine, f"{house.name}, {len(house.faces)} triangles", house, *ends, 2)
    if "speed" in parts:
        cases = [
            ("1 × 1", points[:1], points[6:7]),
            ("6 × 6", points[:6], points[6:12]),
            ("4 × 32", points[:4], points[6] + 0.042 * _sphere(32)),
        ]
        speed(genuine, house, cases, 8)
    if "moves" in parts:
        moves(genuine, house, points, 3)


def _sphere(count: int) -> np.ndarray:
    """(count, 3) unit vectors spread over the sphere."""
    i = np.arange(count) + 0.5
    z, phi = 1.0 - 2.0 * i / count, i * np.pi * (3.0 - np.sqrt(5.0))
    return np.column_stack([np.sqrt(1.0 - z * z) * np.cos(phi), np.sqrt(1.0 - z * z) * np.sin(phi), z])


if __name__ == "__main__":
    main(sys.argv[1:] or PARTS)
