"""Depth pictures of a scene, by casting a ray per pixel."""

from __future__ import annotations

import math
import shlex
from pathlib import Path
from typing import Any

import numpy as np

from soundspaces_sim.core.errors import DatasetError, SoundSpacesSimError
from soundspaces_sim.core.numerics.kernel import kernel
from soundspaces_sim.dataset.reader import RirDataset
from soundspaces_sim.nav.baked_arrays import VIEWS
from soundspaces_sim.scene.load import load_scene
from soundspaces_sim.scene.rays.geometry import Geometry, cast_ray
from soundspaces_sim.scene.scene import Scene


@kernel
def cast_depth(
    geometry: Geometry, camera: np.ndarray, headings: np.ndarray, size: int, out: np.ndarray
) -> None:
    """z-depth in m of a camera at (3,), 90° by 90°, per heading (radians), into `out` (k, size, size);
    0 where nothing is hit. Rows from the top, columns from the left."""
    origin = camera[0], camera[1], camera[2]
    for k in range(len(headings)):
        c, s = math.cos(headings[k]), math.sin(headings[k])
        for i in range(size):
            up = 1.0 - (2.0 * i + 1.0) / size
            for j in range(size):
                left = 1.0 - (2.0 * j + 1.0) / size
                length = math.sqrt(1.0 + left * left + up * up)
                direction = (c - s * left) / length, (s + c * left) / length, up / length
                distance, triangle = cast_ray(geometry, origin, direction, math.inf)
                out[k, i, j] = distance / length if triangle >= 0 else 0.0


def depth_views(
    scene: Scene, positions: np.ndarray, headings_deg: np.ndarray, size: int = 128
) -> np.ndarray:
    """(n, k, size, size) z-depth in m from camera positions (n, 3), at each of k headings; 0: nothing hit."""
    cameras = np.ascontiguousarray(np.asarray(positions, float).reshape(-1, 3) - scene.center)
    angles = np.deg2rad(np.asarray(headings_deg, float).reshape(-1))
    out = np.empty((len(cameras), len(angles), size, size), np.float32)
    for camera, into in zip(cameras, out, strict=True):
        cast_depth(scene.geometry, camera, angles, size, into)
    return out


def scene_of_dataset(ds: RirDataset) -> Scene:
    """The scene that a dataset was made of: a built-in one by its name, another by the command that made it.

    Raises `DatasetError` if it is not there any more, or is another one now.
    """
    source = ds.scene
    options: dict[str, Any] = {}
    words = shlex.split(ds.manifest.command)
    if len(words) > 2 and words[1] == "rirs":
        plain = [
            w
            for i, w in enumerate(words[2:])
            if not w.startswith("-") and not words[1 + i].startswith("-")
        ]
        # One command makes datasets of several scenes.
        own = [word for word in plain if Path(word).stem == ds.scene]
        source = (own or plain or [source])[0]
        for name in ("materials", "labels", "up", "unit", "decimate"):
            if f"--{name}" in words[:-1]:
                options[name] = words[words.index(f"--{name}") + 1]
        if "decimate" in options:
            options["decimate"] = float(options["decimate"])
        for flag, value in (("--ceiling", True), ("--no-ceiling", False)):
            if flag in words:
                options["ceiling"] = value
    try:
        scene = load_scene(source, **options)
    except SoundSpacesSimError as error:
        raise DatasetError(
            f"{ds.path}: the scene that agents would see cannot be loaded ({error}); draw its views where it "
            f"can: `soundspaces-sim nav bake`, and keep {VIEWS} beside the dataset"
        ) from error
    check_scene(ds, scene)
    return scene


def check_scene(ds: RirDataset, scene: Scene) -> None:
    """Raises `DatasetError` unless the dataset was made of this scene."""
    if scene.digest != ds.manifest.scene_digest:
        raise DatasetError(
            f"{ds.path}: views of another scene: '{scene.name}' has digest {scene.digest[:12]}, the dataset "
            f"was made of one with {ds.manifest.scene_digest[:12]}; its mesh or materials have changed: build the "
            "dataset anew"
        )
