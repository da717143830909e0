"""A scene seen from above at a slant, cut open below its ceilings, as one looks into a doll's house."""

from __future__ import annotations

import colorsys
import io
import zlib
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import trimesh
from matplotlib.figure import Figure

from soundspaces_sim import Scene
from soundspaces_sim.parts import publish_file as publish

_PLAIN = {
    "wall": (0.88, 0.87, 0.84),
    "floor": (0.79, 0.68, 0.53),
    "ceiling": (0.9, 0.9, 0.9),
    "rug": (0.62, 0.42, 0.38),
    "bed": (0.93, 0.92, 0.88),
    "pillow": (0.97, 0.97, 0.95),
    "blanket": (0.47, 0.57, 0.71),
    "sofa": (0.40, 0.53, 0.50),
    "cushion": (0.55, 0.66, 0.62),
    "door": (0.60, 0.44, 0.30),
    "window": (0.72, 0.86, 0.95),
    "countertop": (0.62, 0.62, 0.64),
    "base-cabinet": (0.82, 0.78, 0.70),
    "table": (0.66, 0.49, 0.33),
}
_SKY = (1.0, 1.0, 1.0)
_LIGHT = np.array([0.35, -0.25, 0.9]) / np.linalg.norm([0.35, -0.25, 0.9])
_SECTION = (0.25, 0.25, 0.25)  # where the cut goes through something


def above_picture(
    scene: Scene,
    cut: float = 1.5,
    pixels: int = 360,
    azimuth_deg: float = -60.0,
    elevation_deg: float = 55.0,
) -> np.ndarray:
    """(height, width, 3) in 0…1, parallel rays. What is higher than `cut` m above the lowest point is left out;
    what is cut is dark. Colours are those of labels: the same label, the same colour."""
    low, high = scene.bounds
    top = low[2] + cut
    azimuth, elevation = np.deg2rad(azimuth_deg), np.deg2rad(elevation_deg)
    into = -np.array(
        [np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)]
    )
    right = np.array([-np.sin(azimuth), np.cos(azimuth), 0.0])
    up = np.cross(right, into)
    corners = np.array(
        [[x, y, z] for x in (low[0], high[0]) for y in (low[1], high[1]) for z in (low[2], top)]
    )
    u, v = corners @ right, corners @ up
    step = max(np.ptp(u), np.ptp(v)) / pixels
    columns, rows = np.arange(u.min(), u.max(), step), np.arange(v.max(), v.min(), -step)
    across, down = np.meshgrid(columns, rows)
    place = across[..., None] * right + down[..., None] * up
    # Every ray begins where it passes the cut.
    place = place + ((top - place[..., 2]) / into[2])[..., None] * into
    directions = np.broadcast_to(into, place.shape).reshape(-1, 3)
    mesh = trimesh.Trimesh(scene.vertices, scene.faces, process=False)
    face = mesh.ray.intersects_first(place.reshape(-1, 3), directions)
    normals = np.asarray(mesh.face_normals)
    picture = _shaded(scene, normals @ _LIGHT)[face]
    # Whoever sees the back of a face stands in something. Two looks, as a wall's foot and a floor may be one plane.
    level = np.array([0.8, 0.6, 0.0])
    beside = mesh.ray.intersects_first(place.reshape(-1, 3), np.broadcast_to(level, directions.shape))
    inside = (normals[face] @ into > 0.0) | ((normals[beside] @ level > 0.0) & (beside >= 0))
    picture[inside] = _SECTION
    picture[face < 0] = _SKY
    return picture.reshape(*place.shape[:2], 3)


def inside_picture(
    scene: Scene, eye: np.ndarray, azimuth_deg: float, width: int = 320, field_of_view_deg: float = 95.0
) -> np.ndarray:
    """(3/4 width, width, 3) in 0…1: what is seen from `eye` (3,) m in a direction in the plane, 0 along +X."""
    azimuth, half = np.deg2rad(azimuth_deg), np.tan(np.deg2rad(0.5 * field_of_view_deg))
    into = np.array([np.cos(azimuth), np.sin(azimuth), -0.08])
    right = np.array([np.sin(azimuth), -np.cos(azimuth), 0.0])
    height = 3 * width // 4
    u, v = np.meshgrid(np.linspace(-half, half, width), np.linspace(0.75 * half, -0.75 * half, height))
    directions = into + u[..., None] * right + v[..., None] * np.array([0.0, 0.0, 1.0])
    rays = directions.reshape(-1, 3) / np.linalg.norm(directions, axis=-1).reshape(-1, 1)
    mesh = trimesh.Trimesh(scene.vertices, scene.faces, process=False)
    face = mesh.ray.intersects_first(np.broadcast_to(np.asarray(eye, float), rays.shape), rays)
    normals = np.asarray(mesh.face_normals)
    facing = np.abs((normals[face] * rays).sum(axis=1))
    picture = _shaded(scene, normals @ _LIGHT)[face] * (0.7 + 0.3 * facing)[:, None]
    picture[face < 0] = _SKY
    return np.asarray(picture.reshape(height, width, 3))


def _shaded(scene: Scene, lit: np.ndarray) -> np.ndarray:
    """(F, 3) colour of each face, by its label and the cosine `lit` (F,) at which light falls on it. Faces
    without one look like walls."""
    colours = np.array([*map(_colour, scene.labels), _PLAIN["wall"]])[scene.face_label]
    return np.asarray(colours * (0.62 + 0.38 * np.clip(lit, 0.0, 1.0))[:, None])


def _colour(label: str) -> tuple[float, float, float]:
    if label in _PLAIN:
        return _PLAIN[label]
    thing, _, stuff = label.partition("-")
    if thing in _PLAIN and stuff:  # of the same thing, other stuffs have other shades
        shade = 0.82 + 0.18 * (zlib.crc32(stuff.encode()) % 7) / 6.0
        red, green, blue = _PLAIN[thing]
        return shade * red, shade * green, shade * blue
    number = zlib.crc32(label.encode())
    return colorsys.hsv_to_rgb(number % 360 / 360.0, 0.15 + number // 360 % 30 / 100.0, 0.82)


def gallery(scenes: Sequence[Scene], columns: int = 5) -> Figure:
    """A page of scenes, each from above, with its name."""
    rows = -(-len(scenes) // columns)
    figure = Figure(figsize=(3.2 * columns, 2.8 * rows), layout="constrained")
    for k, axes in enumerate(figure.subplots(rows, columns, squeeze=False).ravel()):
        axes.axis("off")
        if k < len(scenes):
            axes.imshow(above_picture(scenes[k]))
            axes.set_title(scenes[k].name, fontsize=9)
    return figure


def write_gallery(scenes: Sequence[Scene], path: Path, columns: int = 6) -> None:
    """The page as a PNG."""
    write_small(gallery(scenes, columns), path)


def write_small(figure: Figure, path: Path, dpi: float = 70) -> None:
    """A figure as a PNG of 128 colours, which is a third of the size."""
    from PIL import Image

    buffer = io.BytesIO()
    figure.savefig(buffer, dpi=dpi, format="png")
    out = io.BytesIO()
    Image.open(buffer).convert("RGB").quantize(128).save(out, "PNG", optimize=True)
    publish(path, out.getvalue())
