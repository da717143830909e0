"""Scenes: how long grid and graph take, and what decimation does to the sound.

Question: How long do placing points and making the graph take, and does decimation change what is heard?

Method: The demo, aws_small_house, and a building of 510 m² (30 × 17 m of rooms and furniture, subdivided to a
million triangles), spacing .5 m, by the clock. The house decimated: mean |difference| of decay curves of 8 × 8
pairs, 4,000 subpaths, from the whole mesh's, beside that of two seeds of the whole mesh.

Amortised: Compiling, and loading the mesh.

Takes: 10 minutes. Needs ../shared and the extra ``decimate``.
"""

from __future__ import annotations

import resource
import time
from collections.abc import Sequence
from typing import Any

import numpy as np
import trimesh

import soundspaces_sim as ss
from benchmarks.tools.curves import decay_curves, edc_difference
from benchmarks.tools.record import Table, table
from benchmarks.tools.scenes import house, shuffled_points
from soundspaces_sim.scene.labelled import LabelledMesh
from soundspaces_sim.scene.materials import MaterialTable
from soundspaces_sim.scene.repair.decimate import decimate_mesh

MEASURES = ("core", "scene", "layout")
_SHARES = (0.5, 0.2, 0.05)


def large_building(triangles: int = 1_000_000) -> ss.Scene:
    """Twelve rooms with doors, tables and cupboards on 510 m², every face cut until there are enough."""
    boxes: list[tuple[Sequence[float], Sequence[float]]] = [
        ((0, 0, -0.2), (30, 17, 0)),
        ((0, 0, 2.8), (30, 17, 3.0)),
    ]
    boxes += [((-0.2, -0.2, 0), (0, 17.2, 2.8)), ((30, -0.2, 0), (30.2, 17.2, 2.8))]
    boxes += [((0, -0.2, 0), (30, 0, 2.8)), ((0, 17, 0), (30, 17.2, 2.8))]
    for x in range(5, 30, 5):
        for y in (0.0, 9.5):
            boxes += [((x, y, 0), (x + 0.12, y + 3.0, 2.8)), ((x, y + 4.0, 0), (x + 0.12, y + 7.5, 2.8))]
    for y in (7.5, 9.5):
        for x in range(0, 30, 5):
            boxes += [((x, y, 0), (x + 2.0, y + 0.12, 2.8)), ((x + 3.0, y, 0), (x + 5.0, y + 0.12, 2.8))]
    for x in range(0, 30, 5):
        for y in (1.0, 11.0):
            boxes += [
                ((x + 1.5, y, 0.7), (x + 3.0, y + 0.9, 0.75)),
                ((x + 4.0, y, 0), (x + 4.6, y + 2.0, 2.0)),
            ]
    mesh: Any = trimesh.util.concatenate([trimesh.creation.box(bounds=b) for b in boxes])
    while len(mesh.faces) < triangles:
        area = mesh.area_faces
        largest = np.argsort(-area)[: max((triangles - len(mesh.faces)) // 3 + 1, 1)]
        mesh = mesh.subdivide(face_index=largest[area[largest] > 0.2 * area[largest[0]]])
    plain = MaterialTable(("any",), np.array([1e3]), *np.full((3, 1, 1), 0.1))
    return ss.Scene(mesh.vertices, mesh.faces, np.zeros(len(mesh.faces), int), plain, name="building")


def _timed(name: str, scene: ss.Scene, spacing: float = 0.5) -> tuple[object, ...]:
    start = time.perf_counter()
    grid = ss.make_grid(scene, spacing)
    between = time.perf_counter()
    graph = ss.make_graph(scene, grid)
    end = time.perf_counter()
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3
    return name, len(scene.faces), len(grid), len(graph.nodes), between - start, end - between, peak


def _decimation(scene: ss.Scene) -> Table:
    points = shuffled_points(scene)[:8]
    config = ss.SimulationConfig(walks=4000, duration=0.8)
    whole = decay_curves(ss.simulate(scene, points, points, config, 0))
    again = decay_curves(ss.simulate(scene, points, points, config, 1))
    rows: list[tuple[object, ...]] = [
        ("two seeds of the whole mesh", len(scene.faces), edc_difference(whole, again))
    ]
    mesh = LabelledMesh(scene.vertices, scene.faces, scene.labels, scene.face_label, scene.name)
    of_label = {int(l): int(m) for l, m in zip(scene.face_label, scene.face_material, strict=True)}
    for share in _SHARES:
        less = decimate_mesh(mesh, share)
        materials = np.array([of_label[int(l)] for l in less.face_label])
        small = ss.Scene(
            less.vertices, less.faces, materials, scene.materials, less.labels, less.face_label, "small"
        )
        curves = decay_curves(ss.simulate(small, points, points, config, 1))
        rows.append((f"decimate={share:g}", len(small.faces), edc_difference(whole, curves)))
    heads = ["", "faces", ("difference of decay curves", "dB")]
    return table("Decimation of the house, 8 × 8 pairs, 4,000 subpaths", heads, rows)


def run() -> list[Table]:
    """Times, decimation."""
    demo, real = ss.load_scene("demo"), house()
    ss.make_graph(demo, ss.make_grid(demo, 2.0))  # compile
    rows = [
        _timed("demo", demo),
        _timed("aws_small_house", real),
        _timed("building of 510 m²", large_building()),
    ]
    heads = [
        "scene",
        "triangles",
        "points",
        "nodes",
        ("grid", "s"),
        ("graph", "s"),
        ("peak memory", "MB"),
    ]
    return [table("Spacing .5 m", heads, rows), _decimation(real)]
