"""Depth observations, read from a file beside the dataset or drawn when they are needed.

z-depth over 10 m, clipped to 1; 0 where nothing is hit, as in Habitat. Field of view 90° by 90°, 1.25 m above
the floor. Pictures are kept in half precision, drawn at 128 by 128; smaller ones whose size divides 128 are
means over areas of those, so that it makes no difference whether pictures were baked.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from soundspaces_sim.core.errors import ConfigError
from soundspaces_sim.dataset.reader import RirDataset
from soundspaces_sim.nav.baked_arrays import VIEWS, read_arrays, write_arrays
from soundspaces_sim.nav.navigation_graph import HEADINGS

if TYPE_CHECKING:
    from soundspaces_sim.scene.scene import Scene

SIZE = 128
CAMERA_HEIGHT = 1.25  # m above the floor
FARTHEST = 10.0  # m
_FORMAT = "soundspaces_sim/views-1"


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
    ds: RirDataset,
    size: int = SIZE,
    scene: Scene | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Path:
    """Draw all nodes and headings into ``views.h5`` beside the dataset, unless it is there. Returns its path."""
    from soundspaces_sim.nav.depth import check_scene, depth_views, scene_of_dataset  # Embree

    path = ds.path / VIEWS
    if path.exists() and Views(ds, size).baked is not None:
        return path
    if scene is None:
        scene = scene_of_dataset(ds)
    check_scene(ds, scene)
    nodes = np.array(ds.manifest.nodes, np.int64)
    drawn = drawn_size(size)
    pictures = np.empty((len(nodes), 4, drawn, drawn), np.float16)
    for k, camera in enumerate(camera_positions(ds, nodes)):
        pictures[k] = normalise(depth_views(scene, camera, np.array(HEADINGS), drawn)[0])
        if progress is not None:
            progress(k + 1, len(nodes))
    return write_arrays(path, _belongs(ds), {"nodes": nodes, "depth": pictures})


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
        found = read_arrays(self.ds.path / VIEWS, "views", _belongs(self.ds), shapes)
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
        from soundspaces_sim.nav.depth import depth_views, scene_of_dataset  # Embree

        if self._scene is None:
            self._scene = scene_of_dataset(self.ds)
        camera = camera_positions(self.ds, np.array([node]))
        return normalise(depth_views(self._scene, camera, np.array(HEADINGS), drawn_size(self.size))[0])
