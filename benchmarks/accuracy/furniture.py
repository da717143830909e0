"""Random furniture in training: what it is worth on rooms with other materials.

Question: How much nearer does a regression that is trained with other materials on every reading come, in rooms
whose materials it has not heard?

Method: Distance of a source from an omnidirectional receiver, from the levels of six windows of time after the
first sound (to 5, 20, 50, 100, 200 and 350 ms) in four bands, each relative to all energy of its band: what a
blind estimator of distance hears, direct-to-reverberant ratio and decay. Kernel ridge regression of the logarithm
of distance, kernel width and penalty by five folds over rooms. Generated single rooms, a source and six listeners
each, 300 subpaths. Training: 5, 15 and 45 rooms, (a) as generated; (b) the same and eight draws of
`RandomMaterials` of each pair on reading; (c) the same and eight simulations with such draws, which (b) stands
for; of 15 rooms at most, for time. Test: 40 other rooms as generated, and with all materials drawn before they
are simulated, once by the spread of products and once by three times that. Root mean square of log2 of the ratio
of distances; intervals of 95 % by bootstrap over the rooms tested; of differences from (a) over the same rooms.

Amortised: Nothing.

Takes: 15 minutes. Arguments: rooms for training (5,15,45), for testing (40).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.spatial.distance import cdist

import soundspaces_sim as ss
from benchmarks.tools.record import Table, table
from benchmarks.tools.scenes import in_own_bands
from soundspaces_sim.core.numerics.bands import DEFAULT_BANDS
from soundspaces_sim.dataset.random_materials import draw_furnished
from soundspaces_sim.echogram.reflection_counts import MaterialGroups, anchors

MEASURES = ("core", "scene", "transport", "echogram", "dataset")
DRAWS, LISTENERS, ANEW = 8, 6, 15
_AFTER_S = (0.005, 0.02, 0.05, 0.1, 0.2, 0.35)
_OWN = ss.RadianceTransferConfig(subpaths="auto")
_CONFIG = ss.SimulationConfig(walks=300, radiance_transfer=_OWN)
_COUNTED = ss.SimulationConfig(
    walks=300, radiance_transfer=_OWN, materials=ss.MaterialsConfig(enabled=True)
)
_SCALES = (1.0, 3.0)  # of the spread of products, in rooms that are tested


def _points(scene: ss.Scene, number: int) -> np.ndarray:
    grid = ss.make_grid(scene, 0.7).points
    return grid[np.random.default_rng(number).permutation(len(grid))[: LISTENERS + 1]]


def _other(scene: ss.Scene, rng: np.random.Generator, scale: float = 1.0) -> ss.Scene:
    """The scene with drawn absorption of every material."""
    materials = scene.materials
    absorption, scattering, transmission = materials.in_bands(DEFAULT_BANDS)
    share, anchor = np.ones(len(absorption)), anchors(absorption, transmission)
    groups = MaterialGroups(tuple(materials.names), share, absorption, transmission, anchor)
    drawn = np.where(
        materials.free_hanging[:, None],
        absorption,
        ss.RandomMaterials(scale).draw(groups, DEFAULT_BANDS, rng),
    )
    return in_own_bands(scene, np.maximum(DEFAULT_BANDS, 1.0), drawn, scattering, transmission)


def _simulated(
    scenes: list[ss.Scene], points: list[np.ndarray], seed: int, config: ss.SimulationConfig = _CONFIG
) -> list[list[ss.Echogram]]:
    """Of each scene, its listeners' echograms."""
    echoes = ss.simulate_many(
        scenes, [p[:1] for p in points], [p[1:] for p in points], config, seed=seed, jobs=1
    )
    return [[e[0, l] for l in range(e.energy.shape[1])] for e in echoes]


def _features(echogram: ss.Echogram) -> np.ndarray:
    """(24,) dB of windows after the first sound relative to all energy, per band."""
    bins = echogram.histogram(0.001)
    onset = int((bins.sum(axis=0) > 0.0).argmax())
    upto = np.concatenate([[0.0 * bins[:, 0]], bins[:, onset:].cumsum(axis=1).T])
    ends = [min(int(1000 * t), len(upto) - 1) for t in _AFTER_S]
    windows = np.diff(upto[[0, *ends]], axis=0)
    return np.asarray(10.0 * np.log10(windows / upto[-1] + 1e-6)).ravel()


class _Rows(NamedTuple):
    x: np.ndarray  # (n, 24) features
    y: np.ndarray  # (n,) log2 of distances, m
    room: np.ndarray  # (n,)


def _rows(rooms: list[list[ss.Echogram]], distances: list[np.ndarray]) -> _Rows:
    return _Rows(
        np.array([_features(e) for room in rooms for e in room]),
        np.log2(np.concatenate(distances[: len(rooms)])),
        np.repeat(np.arange(len(rooms)), [len(room) for room in rooms]),
    )


def _with(plain: _Rows, rooms: list[list[list[ss.Echogram]]], distances: list[np.ndarray]) -> _Rows:
    """Rows, and those of as many rooms of further sets."""
    count = int(plain.room.max()) + 1
    parts = [plain, *(_rows(one[:count], distances) for one in rooms)]
    return _Rows(*(np.concatenate(values) for values in zip(*parts, strict=True)))


def _fit(x: np.ndarray, y: np.ndarray, to: np.ndarray, width: float, penalty: float) -> np.ndarray:
    """Predictions at `to` by kernel ridge regression."""
    middle, scale = x.mean(axis=0), x.std(axis=0) + 1e-9
    x, to = (x - middle) / scale, (to - middle) / scale
    area = 2.0 * width**2 * x.shape[1]
    kernel, across = (np.exp(-cdist(a, x, "sqeuclidean") / area) for a in (x, to))
    weights = np.linalg.solve(kernel + penalty * np.eye(len(x)), y - y.mean())
    return np.asarray(across @ weights + y.mean())


def _predicted(train: _Rows, to: np.ndarray) -> np.ndarray:
    """Kernel width and penalty with the least error over five folds of rooms."""
    best, settings = np.inf, (1.0, 0.1)
    fold = train.room % 5
    for width in (0.5, 1.0, 2.0, 4.0):
        for penalty in (0.003, 0.03, 0.3, 3.0):
            off = [
                _fit(train.x[fold != k], train.y[fold != k], train.x[fold == k], width, penalty)
                - train.y[fold == k]
                for k in range(5)
            ]
            error = float(np.mean(np.concatenate(off) ** 2))
            if error < best:
                best, settings = error, (width, penalty)
    return _fit(train.x, train.y, to, *settings)


def _interval(of_rooms: np.ndarray, base: np.ndarray | None) -> tuple[float, float, float]:
    """Root mean square of (rooms, listeners) errors and its interval; with `base` of the difference from it."""
    rng = np.random.default_rng(0)

    def value(rows: np.ndarray) -> float:
        own = float(np.sqrt(np.mean(of_rooms[rows] ** 2)))
        return own if base is None else own - float(np.sqrt(np.mean(base[rows] ** 2)))

    draws = [value(rng.integers(0, len(of_rooms), len(of_rooms))) for _ in range(2000)]
    low, high = np.quantile(draws, (0.025, 0.975))
    return value(np.arange(len(of_rooms))), float(low), float(high)


def run(rooms: str = "5,15,45", tested: str = "40") -> list[Table]:
    """One row per number of rooms and kind of training."""
    counts, test = [int(n) for n in rooms.split(",")], int(tested)
    rng = np.random.default_rng(0)
    scenes = [ss.load_scene(f"room-{n}") for n in range(max(counts) + test)]
    points = [_points(scene, n) for n, scene in enumerate(scenes)]
    distances = [np.linalg.norm(p[1:] - p[0], axis=1) for p in points]
    train, held = slice(0, max(counts)), slice(max(counts), None)
    generated = _simulated(scenes[train], points[train], 0, _COUNTED)
    targets = {"as generated": _simulated(scenes[held], points[held], 1)}
    for number, scale in enumerate(_SCALES):
        other = [_other(scene, rng, scale) for scene in scenes[held]]
        targets[f"other materials, {scale:g} × spread"] = _simulated(other, points[held], 2 + number)
    drawn = [
        [[draw_furnished(e, ss.RandomMaterials(), rng)[0] for e in room] for room in generated]
        for _ in range(DRAWS)
    ]
    anew = [
        _simulated([_other(scene, rng) for scene in scenes[:ANEW]], points[:ANEW], 9 + k)
        for k in range(DRAWS)
    ]
    truth = {name: _rows(echoes, distances[held]) for name, echoes in targets.items()}
    rows: list[tuple[object, ...]] = []
    for count in counts:
        plain = _rows(generated[:count], distances)
        kinds = {"as generated": plain, "random furniture on reading": _with(plain, drawn, distances)}
        if count <= ANEW:
            kinds["simulated anew"] = _with(plain, anew, distances)
        for where, heard in truth.items():
            base: np.ndarray | None = None
            for kind, data in kinds.items():
                off = (_predicted(data, heard.x) - heard.y).reshape(test, LISTENERS)
                value, low, high = _interval(off, None)
                row = (count, where, kind, value, f"{low:.3f} to {high:.3f}")
                if base is None:
                    base, gain = off, ""
                else:
                    gain = "{:+.3f} ({:+.3f} to {:+.3f})".format(*_interval(off, base))
                rows.append((*row, gain))
    columns = (
        "rooms", "tested on rooms", "trained on rooms", "error, log2", "95 %", "against as generated",
    )  # fmt: skip
    return [table("Distance of a source, trained with and without random furniture", columns, rows)]
