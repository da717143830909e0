"""Whether arrays from the disk cache (`core.io.disk_cache`) may be given to kernels, which check no index: types,
shapes, finite numbers, and every index within what it indexes.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from soundspaces_sim.scene.scene import Scene
from soundspaces_sim.transport.diffraction.mutual_visibility import MutualVisibility
from soundspaces_sim.transport.diffraction.wedges import Wedges
from soundspaces_sim.transport.image_source.specular_planes import Planes
from soundspaces_sim.transport.radiance_transfer.patches import Patches
from soundspaces_sim.transport.radiance_transfer.transfer_subpaths import CHUNK, SharedWalks, shared_rows
from soundspaces_sim.transport.state import World

# Type and shape of every array; letters are sizes, which are the same wherever they stand.
_PLANES = {"normal": "f8 P 3", "offset": "f8 P", "margin": "f8 P", "of_face": "i8 F"}
_WEDGES = {
    "start": "f8 E 3", "along": "f8 E 3", "length": "f8 E", "face": "f8 E 3", "normal": "f8 E 3", "n": "f8 E",
    "offset": "f8 E 3",
}  # fmt: skip
_MUTUAL = {"start": "i8 E1", "wedge": "i8 n", "phi": "f8 n 2", "reverse": "i8 n"}
_PATCHES = {
    "dual": "f8 F 2 3", "splits": "i8 F", "first": "i8 F", "of_piece": "i4 n 2", "weight": "f8 C b",
    "middle": "f8 C 3",
}  # fmt: skip
_PLACES = {
    "start": "i8 C1",
    "corners": "f8 m 3 3",
    "normal": "f8 m 3",
    "upto": "f8 m",
    "ratio": "f8 m b",
}
_SHARED = {"start": "i8 M s", "patch": "i4 e", "length": "f4 e", "energy": "f4 e b", "decay": "f8 b"}


def scene_key(scene: Scene) -> tuple[object, ...]:
    """What decides what is made of a scene."""
    return scene.digest, scene.corners.shape, scene.materials.absorption.shape


def scene_fits(
    planes: Planes, by_size: np.ndarray, wedges: Wedges, mutual: MutualVisibility, shape: tuple[int, int]
) -> bool:
    """What `model._look_at` makes; `shape` of `by_size`: faces × bands, or no bands."""
    sizes = {"F": shape[0]}
    if not (_like(planes, _PLANES, sizes) and _like(wedges, _WEDGES, sizes)):
        return False
    if by_size.dtype != np.float64 or by_size.shape != shape or not _within(by_size, 0.0, 1.0):
        return False
    sizes["E1"] = sizes["E"] + 1
    return (
        _like(mutual, _MUTUAL, sizes)
        and _within(planes.of_face, -1, sizes["P"] - 1)
        and _are_starts(mutual.start, sizes["n"])
        and _within(mutual.wedge, 0, sizes["E"] - 1)
        and _within(mutual.reverse, 0, sizes["n"] - 1)
    )


def patches_fit(patches: Patches, faces: int, bands: int) -> bool:
    """What `patches.make_patches` makes of so many faces."""
    sizes = {"F": faces, "b": bands}
    places = patches.places
    flat = patches._replace(places=None)  # type: ignore[arg-type]
    if not _like(flat, _PATCHES, sizes):
        return False
    count = sizes["C"]
    sizes["C1"] = count + 1
    if not _like(places, _PLACES, sizes):
        return False
    splits, first = patches.splits, patches.first
    if not (_within(splits, 1, 2**15) and _within(first, 0, sizes["n"])):
        return False
    last = first + np.where(splits > 1, 2 * splits**2, 1)
    return bool(
        (last <= sizes["n"]).all()
        and _within(patches.of_piece, -1, count - 1)
        and (patches.weight >= 0.0).all()
        and _are_starts(places.start, sizes["m"])
        and (places.start[:-1] < sizes["m"]).all()
    )


def shared_fit(walks: SharedWalks, world: World) -> bool:
    """What `shared.trace_shared` makes."""
    rows, patches, bands = shared_rows(world), len(world.patches.weight), world.air.shape[1]
    chunks = -(-patches // CHUNK)
    sizes = {"M": rows, "s": patches * chunks + 1, "b": bands}
    if not _like(walks, _SHARED, sizes) or not _within(walks.patch, 0, patches - 1):
        return False
    start = walks.start
    joined = np.append(start[:, :-1].ravel(), start[-1:, -1])
    if not (_are_starts(joined, sizes["e"]) and (start[:-1, -1] == start[1:, 0]).all()):
        return False
    chunk = np.repeat(np.tile(np.arange(chunks, dtype=np.int32), rows * patches), np.diff(joined))
    return bool(
        (walks.patch // CHUNK == chunk).all()
        and (walks.length >= 0.0).all()
        and (walks.energy >= 0.0).all()
    )


def _like(record: Any, expected: Mapping[str, str], sizes: dict[str, int]) -> bool:
    """Whether the arrays of a record have these types and shapes and are finite; sizes that are not known yet are
    added to `sizes`."""
    for name, text in expected.items():
        array, (kind, *shape) = getattr(record, name), text.split()
        if array.dtype.str[1:] != kind or array.ndim != len(shape):
            return False
        for letter, size in zip(shape, array.shape, strict=True):
            if (int(letter) if letter.isdigit() else sizes.setdefault(letter, size)) != size:
                return False
        if kind[0] == "f" and not np.isfinite(array).all():
            return False
    return True


def _within(array: np.ndarray, least: float, most: float) -> bool:
    return bool(((array >= least) & (array <= most)).all())


def _are_starts(start: np.ndarray, count: int) -> bool:
    """Whether these are the first rows of consecutive groups of `count` rows, and the end of the last."""
    return bool(start[0] == 0 and start[-1] == count and (np.diff(start) >= 0).all())
