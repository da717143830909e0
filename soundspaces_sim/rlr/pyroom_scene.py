"""What `pyroom` is made of: materials, scenes of boxes and prisms, and responses in them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from soundspaces_sim.core.config import SimulationConfig
from soundspaces_sim.rlr.errors import RlrError, as_runtime_errors
from soundspaces_sim.rlr.materials import concatenate_tables
from soundspaces_sim.rlr.preparation import Kept
from soundspaces_sim.rlr.propagation import Propagation, group_listeners, noise_seeds
from soundspaces_sim.rlr.records import ChannelLayout, ChannelLayoutType, Config
from soundspaces_sim.rlr.render import GroupListener, render_group
from soundspaces_sim.scene.build import WALLS, shoebox
from soundspaces_sim.scene.materials import MaterialTable, load_materials
from soundspaces_sim.scene.polygons import newell_normal, triangulate
from soundspaces_sim.scene.scene import Scene

C = SimulationConfig().c  # m/s
_OCTAVES = 125.0 * 2.0 ** np.arange(7)
_MONO = ChannelLayout(ChannelLayoutType.Mono, 1)


class Material:
    """What a wall is of: `energy_absorption` and `scattering` (None: none scattered), shares of energy: a number, a
    mapping of `coeffs` and their `center_freqs` (octaves from 125 Hz on by default), or for the former the name of
    a material of this package."""

    def __init__(self, energy_absorption: Any, scattering: Any = None) -> None:
        with as_runtime_errors():
            if isinstance(energy_absorption, str):
                self.table = _named(energy_absorption)
                return
            known = [
                _curve(energy_absorption, "energy_absorption"),
                _curve(0.0 if scattering is None else scattering, "scattering"),
            ]
            at = np.unique(np.concatenate([f for f, _ in known]))
            absorbed, scattered = (np.interp(np.log(at), np.log(f), v)[None] for f, v in known)
            name = f"absorption {absorbed[0].tolist()}, scattering {scattered[0].tolist()} at {at.tolist()} Hz"
            self.table = MaterialTable((name,), at, absorbed, scattered, np.zeros_like(absorbed))


def _named(name: str) -> MaterialTable:
    """A material of the database alone."""
    whole = load_materials()
    row = whole.index(name)
    one = slice(row, row + 1)
    return MaterialTable(
        (name,),
        whole.frequency_hz,
        whole.absorption[one],
        whole.scattering[one],
        whole.transmission[one],
    )


def _curve(value: Any, what: str) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies, Hz, and values at them."""
    if isinstance(value, Mapping):
        values = np.atleast_1d(np.array(value.get("coeffs", ()), float))
        at = np.atleast_1d(np.array(value.get("center_freqs", _OCTAVES[: len(values)]), float))
    elif isinstance(value, int | float | np.number):
        values, at = np.array([float(value)]), np.array([1000.0])
    else:
        raise RlrError(
            f"{what}: expected a number, a mapping of coeffs and center_freqs or a name, got {value!r}"
        )
    if not (len(at) == len(values) > 0 and (np.diff(at) > 0.0).all() and at[0] > 0.0):
        raise RlrError(f"{what}: expected as many coeffs as rising center_freqs, got {value!r}")
    return at, values


def make_materials(*args: Any, **kwargs: Any) -> Any:
    """Materials of absorptions, or of pairs of absorption and scattering: a list of those given by place, a mapping
    of those given by name."""

    def one(value: Any) -> Material:
        return Material(*value) if isinstance(value, tuple) else Material(value)

    if args and kwargs:
        raise RlrError("make_materials: expected materials by place or by name, got both")
    return [one(a) for a in args] if args else {name: one(value) for name, value in kwargs.items()}


def _joined(materials: Sequence[Any]) -> tuple[MaterialTable, np.ndarray]:
    """One table of some materials, and the row of each."""
    wrong = [m for m in materials if not isinstance(m, Material)]
    if wrong:
        raise RlrError(f"materials: expected pra.Material, got {type(wrong[0]).__name__}")
    tables = {m.table.names[0]: m.table for m in materials}
    names = list(tables)
    return concatenate_tables(list(tables.values())), np.array(
        [names.index(m.table.names[0]) for m in materials]
    )


def box_scene(size: Any, materials: Any) -> Scene:
    """A shoebox of `size` (3,) m."""
    if np.shape(size) != (3,):
        raise RlrError(f"ShoeBox: rooms are three-dimensional here, got {size!r}")
    if isinstance(materials, Mapping) and set(materials) != set(WALLS):
        raise RlrError(
            f"materials: expected one for each of {', '.join(WALLS)}, got {', '.join(materials)}"
        )
    of_wall = materials if isinstance(materials, Mapping) else dict.fromkeys(WALLS, materials)
    plain = shoebox(size)
    table, row = _joined([of_wall[wall] for wall in WALLS])
    return Scene(
        plain.vertices, plain.faces, np.repeat(row, 2), table, WALLS, np.repeat(range(6), 2), "ShoeBox"
    )


def prism_scene(corners: np.ndarray, height: float, walls: Any, ends: Any) -> Scene:
    """An upright prism over a floor of corners (2, n), m. `walls`: a material, or one for each side; `ends`: of
    floor and ceiling, one or a mapping of both, or None for the material of the first side."""
    if not 0.0 < height < math.inf:
        raise RlrError(f"extrude: height: expected a positive length in m, got {height!r}")
    count = corners.shape[1]
    floor = np.column_stack([corners.T, np.zeros(count)])
    if newell_normal(floor)[2] < 0.0:
        floor = floor[::-1]  # as pyroomacoustics does; walls are then numbered in the new order
    flat = triangulate(floor, "from_corners")
    after = np.roll(np.arange(count), -1)
    low, high = np.arange(count), np.arange(count) + count
    sides = np.stack(
        [np.column_stack([low, low[after], high[after]]), np.column_stack([low, high[after], high])],
        axis=1,
    )
    faces = np.concatenate([sides.reshape(-1, 3), flat[:, ::-1], flat + count])
    of_side = list(walls) if isinstance(walls, Sequence) else [walls] * count
    if len(of_side) != count:
        raise RlrError(f"from_corners: materials: expected one or {count}, got {len(of_side)}")
    of_end = (
        ends if isinstance(ends, Mapping) else dict.fromkeys(("floor", "ceiling"), ends or of_side[0])
    )
    if set(of_end) != {"floor", "ceiling"}:
        raise RlrError("extrude: materials: expected one of floor and one of ceiling")
    table, row = _joined([*of_side, of_end["floor"], of_end["ceiling"]])
    label = np.repeat(np.arange(count + 2), [2] * count + [len(flat)] * 2)
    names = (*(str(i) for i in range(count)), "floor", "ceiling")
    vertices = np.concatenate([floor, floor + np.array([0.0, 0.0, height])])
    return Scene(vertices, faces, row[label], table, names, label, "Room")


def inside(scene: Scene, points: np.ndarray) -> np.ndarray:
    """(n,) whether points (n, 3) are in a closed scene: whether its faces cover the whole sphere around them."""
    a, b, c = (scene.corners[None, :, k] - points[:, None] for k in range(3))
    la, lb, lc = (np.linalg.norm(v, axis=2) for v in (a, b, c))
    volume = np.einsum("nfi,nfi->nf", a, np.cross(b, c))
    beside = (
        la * lb * lc
        + np.einsum("nfi,nfi->nf", a, b) * lc
        + np.einsum("nfi,nfi->nf", b, c) * la
        + np.einsum("nfi,nfi->nf", c, a) * lb
    )
    return np.asarray(
        np.abs(np.arctan2(volume, beside).sum(axis=1)) > math.pi
    )  # half of 4 π is a face's 2 π


def responses(
    scene: Scene, sources: np.ndarray, places: np.ndarray, rate: float, indirect: bool, seed: int
) -> list[list[np.ndarray]]:
    """(n,) float64 responses [place][source] between (S, 3) and (M, 3) points, m; direct sound 1 / r. Places within
    0.3 m are one simulation."""
    config = Config(
        sample_rate=float(rate), indirect=int(indirect), global_volume=math.sqrt(4.0 * math.pi)
    )
    groups = group_listeners(places)
    middles = np.ascontiguousarray(places[[g.place for g in groups]])
    table = Propagation(scene, np.zeros(len(scene.faces), np.int64), Kept()).echograms(
        sources, middles, config
    )
    seeds = noise_seeds(sources, middles, False) + np.uint64(seed)
    out: list[list[np.ndarray]] = [[np.empty(0)] * len(sources) for _ in places]
    for s in range(len(sources)):
        for g, group in enumerate(groups):
            ears = [GroupListener(places[i] - middles[g], _MONO, np.eye(3), None) for i in group.members]
            distance = np.linalg.norm(places[list(group.members)] - sources[s], axis=1).tolist()
            found = render_group(table[s][g], ears, distance, config, int(seeds[s, g]))
            for i, response in zip(group.members, found, strict=True):
                out[i][s] = response[0]
    return out
