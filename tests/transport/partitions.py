"""Rooms that partitions seal off, drawn at random."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import trimesh
from scipy.spatial import ConvexHull

import soundspaces_sim as ss
from tests.rooms import table


class Cells(NamedTuple):
    """A scene of rooms between which no sound can pass."""

    scene: ss.Scene
    points: np.ndarray  # (n, 3) m, one in each
    what: str


class _Plane(NamedTuple):
    """The points x of n · x = d."""

    normal: np.ndarray  # (3,) unit
    offset: float  # m


def _clipped(polygon: np.ndarray, plane: _Plane) -> np.ndarray:
    """What of a convex polygon (n, 3) is behind a plane."""
    height = polygon @ plane.normal - plane.offset
    out = []
    for k in range(len(polygon)):
        m = (k + 1) % len(polygon)
        if height[k] <= 0.0:
            out.append(polygon[k])
        if (height[k] <= 0.0) != (height[m] <= 0.0):
            t = height[k] / (height[k] - height[m])
            out.append(polygon[k] + t * (polygon[m] - polygon[k]))
    return np.reshape(out, (-1, 3))


def _cut(plane: _Plane, within: list[_Plane]) -> np.ndarray:
    """The convex polygon (n, 3) that some planes leave of another one."""
    u = np.cross(plane.normal, [0.0, 0.0, 1.0])
    u /= np.linalg.norm(u)
    v = np.cross(plane.normal, u)
    square = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * 100.0
    polygon = plane.offset * plane.normal + square @ np.stack([u, v])
    for other in within:
        polygon = _clipped(polygon, other)
    return np.asarray(polygon)


def _box_planes(size: np.ndarray, beyond: float) -> list[_Plane]:
    """Of a box from the origin, moved out by some m."""
    out = []
    for axis in range(3):
        unit = np.eye(3)[axis]
        out += [_Plane(unit, float(size[axis]) + beyond), _Plane(-unit, beyond)]
    return out


def _sheet(
    polygon: np.ndarray, halvings: int, noise: float, rng: np.random.Generator
) -> trimesh.Trimesh:
    """A polygon in triangles, whose corners within are off its plane by `noise` m."""
    middle = polygon.mean(axis=0)
    n = len(polygon)
    faces = [[k, (k + 1) % n, n] for k in range(n)]
    mesh = trimesh.Trimesh(np.vstack([polygon, middle]), faces, process=False)
    for _ in range(halvings):
        mesh = mesh.subdivide()
    if noise > 0.0:
        a, b = polygon, np.roll(polygon, -1, axis=0)
        along = (b - a) / np.linalg.norm(b - a, axis=1)[:, None]
        off = mesh.vertices[:, None] - a
        far = np.linalg.norm(np.cross(off, along), axis=2).min(axis=1) > 1e-6
        mesh.vertices = mesh.vertices + far[:, None] * rng.normal(0.0, noise, mesh.vertices.shape)
    return mesh


def _body(polygons: list[np.ndarray]) -> trimesh.Trimesh:
    """The convex body of two polygons."""
    points = np.concatenate(polygons)
    return trimesh.Trimesh(points, ConvexHull(points).simplices, process=False)


def _shell(plan: np.ndarray, height: float) -> trimesh.Trimesh:
    """A plan (n, 2), extruded."""
    n = len(plan)
    corners = np.concatenate([np.column_stack([plan, np.full(n, z)]) for z in (0.0, height)])
    flat = [[0, 1, 2], [0, 2, 3]] if n == 4 else [[0, 1, 2], [0, 2, 3], [0, 3, 5], [3, 4, 5]]
    faces = [*flat, *(np.array(flat) + n).tolist()]
    for k in range(n):
        m = (k + 1) % n
        faces += [[k, m, n + m], [k, n + m, n + k]]
    return trimesh.Trimesh(corners, faces, process=False)


def _along(first: np.ndarray, rng: np.random.Generator, turn: float, lean: float) -> np.ndarray:
    """A unit vector near a level one, turned and leaning by up to so many radians."""
    angle = rng.uniform(-turn, turn)
    c, s = np.cos(angle), np.sin(angle)
    level = np.array([c * first[0] - s * first[1], s * first[0] + c * first[1], 0.0])
    normal = level + np.array([0.0, 0.0, np.tan(rng.uniform(-lean, lean))])
    return np.asarray(normal / np.linalg.norm(normal))


def sealed_cells(rng: np.random.Generator) -> Cells:
    """A room, a box or an L, with a partition across it, and at times another one from that to a wall: sheets or
    bodies of up to 30 cm, upright or not, welded, touching, or through the shell, of few triangles or of many."""
    size = np.array([rng.uniform(3.0, 7.0), rng.uniform(2.0, 5.0), rng.uniform(2.2, 3.2)])
    if rng.uniform() < 0.4:
        size = np.round(size, 1)  # walls at round coordinates
    shape = ("box", "box", "L")[rng.integers(3)]
    upright = shape == "L" or rng.uniform() < 0.6
    turn = 0.0 if rng.uniform() < 0.4 else (0.15 if shape == "L" else 0.6)
    kind = ("welded", "touching", "through")[rng.integers(3)]
    thickness = 0.0 if rng.uniform() < 0.4 else float(np.exp(rng.uniform(np.log(0.005), np.log(0.3))))
    beyond = 0.0 if kind != "through" else float(np.exp(rng.uniform(np.log(1e-6), np.log(0.5))))
    halvings, noise = int(rng.integers(0, 4)), float(rng.choice([0.0, 0.0, 0.005]))
    first = _along(np.array([1.0, 0.0, 0.0]), rng, turn, 0.0 if upright else 0.5)
    at = rng.uniform(0.35, 0.65, 3) * size
    if turn == 0.0 and upright and rng.uniform() < 0.5:
        at = np.round(at, 1)
    plane = _Plane(first, float(first @ at))
    planes, half, walls = [plane], 0.5 * thickness, _box_planes(size, beyond)
    if shape == "box" and rng.uniform() < 0.4:  # a T
        second = _along(np.array([0.0, 1.0, 0.0]), rng, min(turn, 0.3), 0.0 if upright else 0.2)
        planes.append(_Plane(second, float(second @ (rng.uniform(0.35, 0.65, 3) * size))))
    if halvings == 0 or thickness > 0.0 or len(planes) > 1:
        noise = 0.0  # what meets at a noisy partition does not touch it
    meshes = []
    for k, p in enumerate(planes):
        within = walls if k == 0 else [*walls, _Plane(-first, -(plane.offset + half) + beyond)]
        if thickness == 0.0:
            meshes.append(_sheet(_cut(p, within), halvings, noise, rng))
        else:
            meshes.append(_body([_cut(_Plane(p.normal, p.offset + h), within) for h in (-half, half)]))
    plan = np.array([[0, 0], [size[0], 0], size[:2], [0, size[1]]], float)
    if shape == "L":
        wide, deep = rng.uniform(0.2, 0.3) * size[0], rng.uniform(1.2, 2.0)
        x, y = size[:2]
        plan = np.array([[0, 0], [x, 0], [x, y], [wide, y], [wide, y + deep], [0, y + deep]])
    shell = _shell(plan, float(size[2]))
    if kind == "welded" and thickness == 0.0 and shape == "box":
        triangles = list(shell.triangles)
        for p in planes:
            back = _Plane(-p.normal, -p.offset)
            triangles = [
                [part[0], part[k], part[k + 1]]
                for triangle in triangles
                for part in (_clipped(np.array(triangle), p), _clipped(np.array(triangle), back))
                for k in range(1, len(part) - 1)
            ]
        shell = trimesh.Trimesh(
            np.reshape(triangles, (-1, 3)), np.arange(3 * len(triangles)).reshape(-1, 3), process=False
        )
    whole: Any = trimesh.util.concatenate([shell, *meshes])
    points: list[np.ndarray] = []
    side: list[tuple[bool, ...]] = []
    while len(points) < len(planes) + 1:
        x = rng.uniform(0.15, 1.0, 3) * (size - 0.15)
        heights = [p.normal @ x - p.offset for p in planes]
        if heights[0] < 0.0:
            heights = heights[:1]
        cell = tuple(bool(h > 0.0) for h in heights)
        if min(np.abs(heights)) > half + 0.15 and cell not in side:
            points.append(x)
            side.append(cell)
    yaw = float(rng.choice([0.0, rng.uniform(0.0, 6.3)]))
    turned = np.array(
        [[np.cos(yaw), -np.sin(yaw), 0.0], [np.sin(yaw), np.cos(yaw), 0.0], [0.0, 0.0, 1.0]]
    )
    materials = table(rng.uniform(0.02, 0.4), rng.uniform(0.2, 1.0))
    scene = ss.Scene(whole.vertices @ turned.T, whole.faces, np.zeros(len(whole.faces), int), materials)
    what = (
        f"{shape} {size.round(3)}, {kind} by {beyond:.2g} m, {thickness:.3f} m thick, "
        f"{len(planes)} planes, {halvings} halvings, noise {noise}, normal {first.round(2)}, yaw {yaw:.2f}"
    )
    return Cells(scene, np.array(points) @ turned.T, what)
