"""What agents see: depth, by Embree, drawn when needed or read from a file beside the dataset.

z-depth over 10 m, clipped to 1; 0 where nothing is hit, as in Habitat. Field of view 90° by 90°, 1.25 m above
the floor. Pictures are kept in half precision, drawn at 128 by 128; smaller ones whose size divides 128 are
means over areas of those, so that it makes no difference whether pictures were baked.
"""

from __future__ import annotations

import hashlib
import shlex
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from soundspaces_sim.core.errors import ConfigError, DatasetError, SoundSpacesSimError
from soundspaces_sim.dataset.reader import RirDataset
from soundspaces_sim.nav.baked_arrays import keep, kept
from soundspaces_sim.nav.navigation_graph import HEADINGS

if TYPE_CHECKING:
    from soundspaces_sim.scene.scene import Scene

SIZE = 128
CAMERA_HEIGHT = 1.25  # m above the floor
FARTHEST = 10.0  # m
NAME = "views.h5"
_FORMAT = "soundspaces_sim/views-1"


def depth_views(
    scene: Scene, positions: np.ndarray, headings_deg: np.ndarray, size: int = SIZE
) -> np.ndarray:
    """(n, k, size, size) z-depth in m from camera positions (n, 3), at each of k headings; 0: nothing hit."""
    from soundspaces_sim.nav.depth import cast_depth

    cameras = np.ascontiguousarray(np.asarray(positions, float).reshape(-1, 3) - scene.center)
    angles = np.deg2rad(np.asarray(headings_deg, float).reshape(-1))
    out = np.empty((len(cameras), len(angles), size, size), np.float32)
    for camera, into in zip(cameras, out, strict=True):
        cast_depth(scene.geometry, camera, angles, size, into)
    return out


def normalise(depth: np.ndarray) -> np.ndarray:
    """Depth in m as agents get it: over 10 m, clipped, in half precision."""
    return np.asarray(np.clip(depth / FARTHEST, 0.0, 1.0), np.float16)


def check_size(size: int) -> int:
    """Raises `ConfigError` unless pictures can be made in this size."""
    if not 8 <= size <= 1024:
        raise ConfigError(f"depth_size: expected 8 to 1024 pixels, got {size}")
    return size


def drawn_size(size: int) -> int:
    """The size in which pictures of `size` pixels are drawn before areas are averaged."""
    return SIZE if SIZE % size == 0 else size


def shrink(pictures: np.ndarray, size: int) -> np.ndarray:
    """(…, size, size): means over areas of (…, n, n) pictures, n a multiple of `size`."""
    n = pictures.shape[-1]
    if n == size:
        return pictures
    f = n // size
    blocks = pictures.astype(np.float32).reshape(*pictures.shape[:-2], size, f, size, f)
    return np.asarray(blocks.mean(axis=(-3, -1)), np.float16)


def scene_of_dataset(ds: RirDataset) -> Scene:
    """The scene that a dataset was made of: a built-in one by its name, another by the command that made it.

    Raises `DatasetError` if it is not there any more, or is another one now.
    """
    from soundspaces_sim.scene.load import load_scene

    source, options = ds.scene, {}
    words = shlex.split(ds.manifest.command)
    if len(words) > 2 and words[1] == "rirs":
        plain = [
            w
            for i, w in enumerate(words[2:])
            if not w.startswith("-") and not words[1 + i].startswith("-")
        ]
        source = plain[0] if plain else source
        for flag, name in (
            ("--materials", "materials"),
            ("--labels", "labels"),
            ("--up", "up"),
            ("--unit", "unit"),
        ):
            if flag in words[:-1]:
                options[name] = words[words.index(flag) + 1]
        if "--decimate" in words[:-1]:
            options["decimate"] = float(words[words.index("--decimate") + 1])  # type: ignore[assignment]
        for flag, value in (("--lid", True), ("--no-lid", False)):
            if flag in words:
                options["lid"] = value  # type: ignore[assignment]
    try:
        scene = load_scene(source, **options)  # type: ignore[arg-type]
    except SoundSpacesSimError as error:
        raise DatasetError(
            f"{ds.path}: the scene that agents would see cannot be loaded ({error}); draw its views where it "
            f"can: `soundspaces-sim nav bake`, and keep {NAME} beside the dataset"
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


def camera_positions(ds: RirDataset, nodes: np.ndarray) -> np.ndarray:
    """(K, 3) m: above the floor of each node."""
    drop = ds.manifest.config.grid.height - CAMERA_HEIGHT
    return np.asarray(ds.points[nodes] - np.array([0.0, 0.0, drop]))


def _belongs(ds: RirDataset) -> dict[str, str]:
    """What pictures are made of."""
    places = camera_positions(ds, np.array(ds.manifest.nodes, np.int64))
    return {
        "format": _FORMAT,
        "scene": ds.manifest.scene_digest,
        "points": hashlib.sha256(np.ascontiguousarray(places, "<f8").tobytes()).hexdigest(),
        "unit": "z-depth / 10 m; (node, heading 0 90 180 270, row from the top, column from the left)",
    }


def bake_views(
    ds: RirDataset, size: int = SIZE, scene: Scene | None = None, progress: Callable[[int, int], None] | None = None
) -> Path:  # fmt: skip
    """Draw all nodes and headings into ``views.h5`` beside the dataset, unless it is there. Returns its path."""
    path = ds.path / NAME
    if path.exists() and Views(ds, size).baked is not None:
        return path
    scene = scene or scene_of_dataset(ds)
    check_scene(ds, scene)
    nodes = np.array(ds.manifest.nodes, np.int64)
    drawn = drawn_size(size)
    pictures = np.empty((len(nodes), 4, drawn, drawn), np.float16)
    for k, camera in enumerate(camera_positions(ds, nodes)):
        pictures[k] = normalise(depth_views(scene, camera, np.array(HEADINGS), drawn)[0])
        if progress is not None:
            progress(k + 1, len(nodes))
    return keep(path, _belongs(ds), {"nodes": nodes, "depth": pictures})


class Views:
    """Depth pictures of one dataset by state: from ``views.h5`` if it is there, else drawn and kept.

    `baked` (K, 4, n, n) half precision, or None. Raises `DatasetError` if the file is of another scene.
    """

    def __init__(self, ds: RirDataset, size: int = SIZE) -> None:
        self.ds, self.size = ds, check_size(size)
        self.row = np.full(len(ds.points), -1)
        self.row[np.array(ds.manifest.nodes, int)] = np.arange(len(ds.manifest.nodes))
        self.baked = self._read()
        self._small: dict[int, np.ndarray] = {}
        self._scene: Scene | None = None

    def _read(self) -> np.ndarray | None:
        count = len(self.ds.manifest.nodes)
        shapes = {"nodes": (count,), "depth": (count, len(HEADINGS), None, None)}
        found = kept(self.ds.path / NAME, "views", _belongs(self.ds), shapes)
        if found is None or found["depth"].shape[2:] != (drawn_size(self.size),) * 2:
            return None
        return found["depth"]

    def at(self, node: int) -> np.ndarray:
        """(4, size, size) half precision, by heading."""
        if node not in self._small:
            self._small[node] = shrink(self._full(node), self.size)
        return self._small[node]

    def _full(self, node: int) -> np.ndarray:
        if self.baked is not None:
            return np.asarray(self.baked[self.row[node]])
        if self._scene is None:
            self._scene = scene_of_dataset(self.ds)
        camera = camera_positions(self.ds, np.array([node]))
        return normalise(depth_views(self._scene, camera, np.array(HEADINGS), drawn_size(self.size))[0])
