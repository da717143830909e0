"""Small scenes with known acoustics, for tests."""

from __future__ import annotations

import numpy as np
import trimesh

import soundspaces_sim as ss
from soundspaces_sim.core.numerics.bands import DEFAULT_BANDS


def table(absorption: object, scattering: object, transmission: object = 0.0) -> ss.MaterialTable:
    """One material, or one per row; scalars, (m,) per material, or (m, 4) per default band."""
    rows = [np.atleast_1d(np.asarray(v, float)) for v in (absorption, scattering, transmission)]
    columns = [r if r.ndim == 2 else r[:, None] for r in rows]
    m = max(c.shape[0] for c in columns)
    k = max(c.shape[1] for c in columns)
    a, s, t = (np.broadcast_to(c, (m, k)) for c in columns)
    # Frequencies whose geometric middles are the band edges: band means return the rows as they are.
    second, (_, e1, e2, e3, _) = 400.0, DEFAULT_BANDS
    third = e2**2 / second
    frequency = [1000.0] if k == 1 else [e1**2 / second, second, third, e3**2 / third]
    return ss.MaterialTable(tuple(f"m{i}" for i in range(m)), np.array(frequency), a, s, t)


def box(size: tuple[float, float, float], materials: ss.MaterialTable, rows: object = 0) -> ss.Scene:
    """Shoebox from the origin to `size`; `rows`: material of all faces, or of -x +x -y +y -z +z."""
    lx, ly, lz = size
    v = np.array([[x, y, z] for x in (0, lx) for y in (0, ly) for z in (0, lz)], float)
    quads = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
    faces = np.array([[q[0], q[i], q[i + 1]] for q in quads for i in (1, 2)])
    of_wall = np.broadcast_to(np.asarray(rows), (6,))
    return ss.Scene(v, faces, np.repeat(of_wall, 2), materials, name="box")


def sphere(radius: float, materials: ss.MaterialTable, subdivisions: int = 5) -> ss.Scene:
    """Icosphere, scaled to the volume of the true sphere."""
    mesh = trimesh.creation.icosphere(subdivisions=subdivisions, radius=radius)
    scale = (4.0 / 3.0 * np.pi * radius**3 / mesh.volume) ** (1.0 / 3.0)
    return ss.Scene(
        mesh.vertices * scale, mesh.faces, np.zeros(len(mesh.faces), int), materials, name="sphere"
    )


def plane(half: float, materials: ss.MaterialTable) -> ss.Scene:
    """A square at z = 0, for an infinite wall."""
    v = np.array([[-half, -half, 0], [half, -half, 0], [half, half, 0], [-half, half, 0]], float)
    return ss.Scene(v, np.array([[0, 1, 2], [0, 2, 3]]), np.zeros(2, int), materials, name="plane")


def two_rooms(
    materials: ss.MaterialTable, wall_row: int = 0, door: bool = True, gap: float = 0.0
) -> ss.Scene:
    """Two rooms of 4 x 4 x 2.5 m, side by side along x, a thin wall at x = 4 with a door in it.

    `gap`, m: what a wall without a door leaves open above the floor.
    """
    outer = box((8.0, 4.0, 2.5), materials)
    if door:
        rects = [(0.0, 1.5, 0.0, 2.5), (2.4, 4.0, 0.0, 2.5), (1.5, 2.4, 2.0, 2.5)]
    else:
        rects = [(0.0, 4.0, gap, 2.5)]
    v, f = [outer.vertices], [outer.faces]
    n = len(outer.vertices)
    for y0, y1, z0, z1 in rects:
        v.append(np.array([[4, y0, z0], [4, y1, z0], [4, y1, z1], [4, y0, z1]], float))
        f.append(np.array([[n, n + 1, n + 2], [n, n + 2, n + 3]]))
        n += 4
    faces = np.concatenate(f)
    rows = np.zeros(len(faces), int)
    rows[len(outer.faces) :] = wall_row
    return ss.Scene(np.concatenate(v), faces, rows, materials, name="two_rooms")


def plain(**settings: object) -> ss.SimulationConfig:
    """A config without air absorption, diffraction, scattering by size, and absorption by angle, which closed forms
    and other tracers lack, and with bins that are unbiased."""
    without = {"air_absorption": False, "diffraction": False, "scattering": "table", "denoise": False}
    return ss.SimulationConfig(**{**without, "reflection": "random", **settings})  # type: ignore[arg-type]


def edges_alone(**settings: object) -> ss.SimulationConfig:
    """`plain` with diffraction, and with few subpaths: for what is made pair by pair."""
    few = {"walks": 16, "connections": {"subpaths": 0}, "specular": {"ratio": 1}, "duration": 0.05}
    return plain(**{**few, "radiance_transfer": False, "diffraction": True, **settings})


def in_free_air(body: trimesh.Trimesh, absorption: float = 0.0) -> ss.Scene:
    """A body, rigid by default, in a room far off that takes nearly all."""
    room = trimesh.creation.box(bounds=[[-20.0] * 3, [30.0] * 3])
    room.invert()
    faces = np.concatenate([body.faces, room.faces + len(body.vertices)])
    material = np.repeat([0, 1], [len(body.faces), len(room.faces)])
    vertices = np.concatenate([body.vertices, room.vertices])
    return ss.Scene(vertices, faces, material, table([absorption, 0.9999], [0.0, 0.0]), name="body")
