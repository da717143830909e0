"""Scenes: how long grid and graph take, and what decimation does to the sound.

    .venv/bin/python -m benchmarks.scenes

The large building is 30 × 17 m of rooms and furniture, subdivided to a million triangles.
"""

from __future__ import annotations

import resource
import time

import numpy as np
import trimesh

import soundspaces_sim as ss
from benchmarks.engine import HOUSE, decay_curves, edc_difference
from soundspaces_sim.scene.labelled import LabelledMesh
from soundspaces_sim.scene.materials import MaterialTable
from soundspaces_sim.scene.repair.decimate import decimate_mesh


def large_building(triangles: int = 1_000_000) -> ss.Scene:
    """Twelve rooms with doors, tables and cupboards on 510 m², every face cut until there are enough."""
    boxes = [((0, 0, -0.2), (30, 17, 0)), ((0, 0, 2.8), (30, 17, 3.0))]
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
    mesh = trimesh.util.concatenate([trimesh.creation.box(bounds=b) for b in boxes])
    while len(mesh.faces) < triangles:
        area = mesh.area_faces
        largest = np.argsort(-area)[: max((triangles - len(mesh.faces)) // 3 + 1, 1)]
        mesh = mesh.subdivide(face_index=largest[area[largest] > 0.2 * area[largest[0]]])
    plain = MaterialTable(("any",), np.array([1e3]), *np.full((3, 1, 1), 0.1))
    return ss.Scene(mesh.vertices, mesh.faces, np.zeros(len(mesh.faces), int), plain, name="building")


def time_scene(name: str, scene: ss.Scene, spacing: float) -> None:
    start = time.perf_counter()
    grid = ss.make_grid(scene, spacing)
    middle = time.perf_counter()
    graph = ss.make_graph(scene, grid)
    end = time.perf_counter()
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3
    print(
        f"{name:<18s}{len(scene.faces):>11,d}{len(grid):>8d}{len(graph.nodes):>8d}{middle - start:>9.1f}"
        f"{end - middle:>9.1f}{peak:>10.0f}"
    )


def decimation(scene: ss.Scene) -> None:
    """Mean |difference| of decay curves of 8 × 8 points from the whole mesh's, beside two seeds of that."""
    print("\ndecimation of the house: 8 x 8 pairs, 4000 walks")
    print(f"{'faces':>10s}{'|dEDC| dB':>12s}")
    grid = ss.make_grid(scene, 1.0).points
    points = grid[np.random.default_rng(0).permutation(len(grid))[:8]]
    config = ss.SimulationConfig(walks=4000, duration=0.8)
    whole = decay_curves(ss.simulate(scene, points, points, config, 0))
    again = decay_curves(ss.simulate(scene, points, points, config, 1))
    print(f"{len(scene.faces):>10,d}{edc_difference(whole, again):>12.2f}  (two seeds)")
    mesh = LabelledMesh(scene.vertices, scene.faces, scene.labels, scene.face_label, scene.name)
    for share in (0.5, 0.2, 0.05):
        less = decimate_mesh(mesh, share)
        table = {int(l): int(m) for l, m in zip(scene.face_label, scene.face_material, strict=True)}
        rows = np.array([table[int(l)] for l in less.face_label])
        small = ss.Scene(
            less.vertices, less.faces, rows, scene.materials, less.labels, less.face_label, "small"
        )
        curves = decay_curves(ss.simulate(small, points, points, config, 1))
        print(f"{len(small.faces):>10,d}{edc_difference(whole, curves):>12.2f}")


def main() -> None:
    print(
        f"{'scene':<18s}{'triangles':>11s}{'points':>8s}{'nodes':>8s}{'grid s':>9s}{'graph s':>9s}{'peak MB':>10s}"
    )
    demo = ss.load_scene("demo")
    ss.make_graph(demo, ss.make_grid(demo, 2.0))  # compile
    time_scene("demo", demo, 0.5)
    house = ss.load_scene(HOUSE) if HOUSE.is_dir() else None
    if house is not None:
        time_scene("aws_small_house", house, 0.5)
    time_scene("building", large_building(), 0.5)
    if house is not None:
        decimation(house)


if __name__ == "__main__":
    main()
