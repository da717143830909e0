"""Rectangular rooms: paths of specular reflections alone as image sources of a lattice, to the last one.

In an empty box the images of a source behind six walls fill space with a lattice, all of them in sight (Allen &
Berkley 1979, JASA 65 (4)). The image of number m along an axis, on which the room reaches from 0 to L, is at
m L + x for even m and at (m + 1) L - x for odd m; its path meets the far wall ceil(m / 2) times and the near one
floor(m / 2) times for m > 0, and the other way round for m < 0. So late sound that nothing scatters, which falls on
few directions between the hardest walls, is known without noise, where subpaths find it with the most.

Lattices grow with the cube of the length of paths. Longer paths than `Settings.images_length` are left to specular
subpaths, as in all other rooms; those of one or two reflections, and of three between two walls, to `arrivals`.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from soundspaces_sim.core.numerics.kernel import kernel, over_rows, part
from soundspaces_sim.core.numerics.rows import unique_rows
from soundspaces_sim.core.profile import stage
from soundspaces_sim.scene.rays.geometry import Geometry
from soundspaces_sim.transport.arrivals.images import by_images
from soundspaces_sim.transport.bsdf.surface import Surfaces, attenuate_specular, group_count
from soundspaces_sim.transport.model import Model
from soundspaces_sim.transport.state import World
from soundspaces_sim.transport.tables import BATCHES, CHANNELS, absorb_air, harmonics, time_bin
from soundspaces_sim.transport.tile import Sums, Tile, Walks

_IMAGES = 2**15  # of a source, whose paths are made one by one
_COSINES = 512  # of angles of incidence, between which logarithms of reflected energies are on a line
_SAME = 1e-6  # m, or of one
_THIN = 1e-3  # m
_LEAST = 1e-300  # energy, so that its logarithm is finite


class Box(NamedTuple):
    """A room with six walls; walls are ordered (axis, near or far)."""

    low: np.ndarray  # (3,) m, the corner from which axes start, relative to the scene's centre
    axes: np.ndarray  # (3, 3) unit
    size: np.ndarray  # (3,) m
    kept: np.ndarray  # (3, 2, cosines + 1, b) logarithm of what a wall reflects specularly


class _Images(NamedTuple):
    """Scratch of a pair."""

    there: np.ndarray  # (bins, 9, b) energies with harmonics of the direction at the first point
    back: np.ndarray  # (bins, 9, b) at the second
    log: np.ndarray  # (b,)
    energy: np.ndarray  # (b,)
    at_first: np.ndarray  # (9,)
    at_second: np.ndarray  # (9,)


def images_length(geometry: Geometry, corners: np.ndarray, surfaces: Surfaces, longest: float) -> float:
    """Up to which length, m, images make the specular paths of a scene with these `corners` (F, 3, 3): 0 if it is
    no empty box whose reflections need not be counted."""
    walls = find_walls(geometry, corners)
    if walls is None or group_count(surfaces) or not _are_mirrors(geometry.plane, walls.faces):
        return 0.0
    if not all(_alike(surfaces, *rows) for rows in _materials(geometry, walls)):
        return 0.0
    volume = float(np.prod(walls.size))
    return min((3.0 * volume * _IMAGES / (4.0 * math.pi)) ** (1.0 / 3.0), longest)


class Walls(NamedTuple):
    """Of an empty box, of two triangles each."""

    low: np.ndarray  # as `Box` has it
    axes: np.ndarray
    size: np.ndarray
    faces: np.ndarray  # (3, 2, 2) triangles of each wall
    inner: np.ndarray  # (3, 2, 2) the side on which the room is, 0 in front of the stored normal


def find_walls(geometry: Geometry, corners: np.ndarray) -> Walls | None:
    """The walls of a scene that is an empty box; None if it is none. `corners` (F, 3, 3) m."""
    if len(corners) != 12:
        return None
    flat = corners.reshape(-1, 3)
    whole = np.round(flat / _SAME).astype(np.int64)
    places = flat[unique_rows(whole - whole.min(axis=0))[0]]
    axes = [geometry.normal[0]]
    for normal in geometry.normal[1:]:
        if all(abs(float(normal @ axis)) < _SAME for axis in axes):
            axes.append(normal)
    if len(places) != 8 or len(axes) != 3:
        return None
    frame = np.array(axes)
    at = places @ frame.T
    low, high = at.min(axis=0), at.max(axis=0)
    size = high - low
    if (np.minimum(at - low, high - at) > _SAME).any() or size.min() < _THIN:
        return None
    faces, inner = np.zeros((3, 2, 2), np.int64), np.zeros((3, 2, 2), np.int64)
    for axis, far in np.ndindex(3, 2):
        on_wall = np.abs(corners @ frame[axis] - (high if far else low)[axis]) < _SAME
        found = np.flatnonzero(on_wall.all(axis=1))
        area = np.linalg.norm(np.cross(*(np.diff(corners[found], axis=1).swapaxes(0, 1))), axis=1).sum()
        if len(found) != 2 or abs(area / (2.0 * np.prod(np.delete(size, axis))) - 1.0) > _SAME:
            return None
        outward = frame[axis] if far else -frame[axis]
        faces[axis, far], inner[axis, far] = found, geometry.normal[found] @ outward > 0.0
    return Walls(low @ frame, frame, size, faces, inner)


def _materials(geometry: Geometry, walls: Walls) -> np.ndarray:
    """(6, 2) rows of surfaces of the triangles of each wall, in the room."""
    return np.asarray(geometry.material[walls.faces, walls.inner].reshape(6, 2))


def outer_sides(geometry: Geometry, corners: np.ndarray) -> np.ndarray:
    """(F, 2) sides of triangles, in front of and behind their normals, that are those of an empty box away from the
    room: no sound that leaves it meets them."""
    out = np.zeros((len(corners), 2), bool)
    walls = find_walls(geometry, corners)
    if walls is not None:
        out[walls.faces.ravel(), 1 - walls.inner.ravel()] = True
    return out


def _are_mirrors(plane: np.ndarray, faces: np.ndarray) -> bool:
    """Whether each wall, of `faces` (3, 2, 2), is one plane of its own in `plane` (F,)."""
    of_wall = plane[faces].reshape(6, 2)
    alike = (of_wall[:, 0] == of_wall[:, 1]).all()
    return bool(alike and (of_wall >= 0).all() and len(np.unique(of_wall)) == 6)


def _alike(surfaces: Surfaces, one: int, other: int) -> bool:
    """Whether two kinds of surface reflect alike."""
    tables = surfaces.energy, surfaces.law, surfaces.parameters
    return all(np.array_equal(table[one], table[other]) for table in tables)


def box_of(model: Model) -> Box:
    """The box of a model that has `Settings.images_length`: `model.first.once(box_of)`."""
    world, scene = model.world, model.scene
    walls = find_walls(world.geometry, scene.corners - scene.center)
    assert walls is not None  # or that length would be 0
    material = np.ascontiguousarray(_materials(world.geometry, walls)[:, 0])
    bands = world.air.shape[1]
    kept = np.ones((6, _COSINES + 1, bands))
    over_rows(_fill, 6, world.surfaces, material, kept, least=6)
    log = np.log(np.maximum(kept, _LEAST)).reshape(3, 2, -1, bands)
    return Box(walls.low, walls.axes, walls.size, log)


@kernel
def _fill(first: int, last: int, surfaces: Surfaces, material: np.ndarray, kept: np.ndarray) -> None:
    """Multiply the rows of `kept` (walls, cosines, b) by what is reflected specularly."""
    for wall in range(first, last):
        for n in range(kept.shape[1]):
            cos = max(n / (kept.shape[1] - 1), 1e-9)
            attenuate_specular(surfaces, material[wall], cos, kept[wall, n])


@part(forceinline=True)
def _image(size: float, x: float, m: int) -> float:
    """Where image m of a place is, m."""
    return m * size + (x if m % 2 == 0 else size - x)


@part(forceinline=True)
def _add_walls(kept: np.ndarray, m: int, cos: float, log: np.ndarray) -> None:
    """Add to `log` (b,) what image m keeps at the two walls (2, cosines + 1, b) of an axis."""
    n = abs(m)
    far, near = (n + 1) // 2, n // 2
    if m < 0:
        far, near = near, far
    x = min(cos, 1.0) * (kept.shape[1] - 1)
    k = min(int(x), kept.shape[1] - 2)
    t = x - k
    for b in range(len(log)):
        log[b] += near * (kept[0, k, b] + t * (kept[0, k + 1, b] - kept[0, k, b]))
        log[b] += far * (kept[1, k, b] + t * (kept[1, k + 1, b] - kept[1, k, b]))


@part(forceinline=True)
def _belongs_to_arrivals(mx: int, my: int, mz: int) -> bool:
    """Whether the path of an image is one of `arrivals`."""
    reflections = abs(mx) + abs(my) + abs(mz)
    return by_images(reflections, reflections == 3 and max(abs(mx), abs(my), abs(mz)) == 3)


@part
def _add_image(
    world: World, box: Box, p: np.ndarray, q: np.ndarray, m: tuple[int, int, int], work: _Images
) -> None:
    """Add the path of image `m` of p that arrives at q; both (3,) along the box's axes from its corner."""
    mx, my, mz = m
    vx = _image(box.size[0], p[0], mx) - q[0]
    vy = _image(box.size[1], p[1], my) - q[1]
    vz = _image(box.size[2], p[2], mz) - q[2]
    length = math.sqrt(vx * vx + vy * vy + vz * vz)
    if length > world.settings.images_length or _belongs_to_arrivals(mx, my, mz):
        return
    row = time_bin(length, world.bin_of_step, world.settings.step)
    if row < 0:
        return
    log, energy, axes = work.log, work.energy, box.axes
    vx, vy, vz = vx / length, vy / length, vz / length
    for b in range(len(log)):
        log[b] = 0.0
    _add_walls(box.kept[0], mx, abs(vx), log)
    _add_walls(box.kept[1], my, abs(vy), log)
    _add_walls(box.kept[2], mz, abs(vz), log)
    for b in range(len(log)):
        energy[b] = math.exp(log[b]) / (4.0 * math.pi * length * length)
    absorb_air(energy, world.air, world.settings.air_step, length)
    harmonics(
        vx * axes[0, 0] + vy * axes[1, 0] + vz * axes[2, 0],
        vx * axes[0, 1] + vy * axes[1, 1] + vz * axes[2, 1],
        vx * axes[0, 2] + vy * axes[1, 2] + vz * axes[2, 2],
        work.at_second,
    )
    # At p sound leaves the other way, but along axes on which it is mirrored an odd number of times.
    vx, vy, vz = vx if mx % 2 else -vx, vy if my % 2 else -vy, vz if mz % 2 else -vz
    harmonics(
        vx * axes[0, 0] + vy * axes[1, 0] + vz * axes[2, 0],
        vx * axes[0, 1] + vy * axes[1, 1] + vz * axes[2, 1],
        vx * axes[0, 2] + vy * axes[1, 2] + vz * axes[2, 2],
        work.at_first,
    )
    for c in range(CHANNELS):
        for b in range(len(energy)):
            work.back[row, c, b] += work.at_first[c] * energy[b]
            work.there[row, c, b] += work.at_second[c] * energy[b]


@part
def _add_all(world: World, box: Box, p: np.ndarray, q: np.ndarray, work: _Images) -> None:
    """Fill `work` with the paths from p to q."""
    longest, size = world.settings.images_length, box.size
    work.there[:] = 0.0
    work.back[:] = 0.0
    most_x, most_y = int(longest / size[0]) + 1, int(longest / size[1]) + 1
    for mx in range(-most_x, most_x + 1):
        x = _image(size[0], p[0], mx) - q[0]
        left_x = longest * longest - x * x
        if left_x < 0.0:
            continue
        for my in range(-most_y, most_y + 1):
            y = _image(size[1], p[1], my) - q[1]
            left = left_x - y * y
            if left < 0.0:
                continue
            most_z = int(math.sqrt(left) / size[2]) + 1
            for mz in range(-most_z, most_z + 1):
                _add_image(world, box, p, q, (mx, my, mz), work)


@kernel
def _add_pairs(
    first: int,
    last: int,
    world: World,
    box: Box,
    pairs: np.ndarray,
    swapped: np.ndarray,
    a: np.ndarray,
    b: np.ndarray,
    there: np.ndarray,
    back: np.ndarray,
    batches: np.ndarray,
    work: _Images,
) -> None:
    """Add the images of the pairs `first` to `last` of (n, 2) to `there` (A, B, bins, 9, b), `back` (B, A, bins, 9,
    b) and, alike in every batch, to `batches` (A, B, rows, windows, b). `a`, `b`: points along the box's axes from
    its corner; a pair has the images of its second point if it is `swapped` (n,)."""
    for n in range(first, last):
        i, j = pairs[n, 0], pairs[n, 1]
        if swapped[n]:
            _add_all(world, box, b[j], a[i], work)
            _add_table(work.back, there[i, j])
            _add_table(work.there, back[j, i])
        else:
            _add_all(world, box, a[i], b[j], work)
            _add_table(work.there, there[i, j])
            _add_table(work.back, back[j, i])
        for t in range(len(work.there)):
            window = world.window_of_bin[t]
            for band in range(work.there.shape[2]):
                for k in range(BATCHES):
                    batches[i, j, k, window, band] += work.there[t, 0, band] / BATCHES


@part
def _add_table(more: np.ndarray, table: np.ndarray) -> None:
    """Add to `table` (bins, 9, b), which may have no bins."""
    for t in range(len(table)):
        for c in range(CHANNELS):
            for b in range(more.shape[2]):
                table[t, c, b] += more[t, c, b]


def join(tile: Tile, _of_a: Walks, _of_b: Walks, sums: Sums) -> None:
    """Add what images make of the pairs of points in the room."""
    model, world = tile.model, tile.model.world
    if world.settings.images_length <= 0.0:
        return
    box = model.first.once(box_of)
    a, b = ((side.ends.points @ box.axes.T) - box.low @ box.axes.T for side in (tile.a, tile.b))
    inside_a, inside_b = (((x > 0.0) & (x < box.size)).all(axis=1) for x in (a, b))
    rows, columns = tile.pairs.T
    keys_a, keys_b = tile.a.ends.keys[rows], tile.b.ends.keys[columns]
    within = inside_a[rows] & inside_b[columns]
    # The images are those of the point with the smaller key: a pair has the same bits both ways.
    one = within & (keys_a != keys_b)
    pairs, swapped = tile.pairs[one], (keys_a > keys_b)[one]
    bins, bands = sums.to_b.shape[2], sums.to_b.shape[4]

    def work() -> _Images:
        there, back = np.empty((bins, CHANNELS, bands)), np.empty((bins, CHANNELS, bands))
        return _Images(there, back, *(np.empty(n) for n in (bands, bands, CHANNELS, CHANNELS)))

    with stage("images in a box"):
        arguments = a, b, sums.to_b, sums.to_a, sums.batches
        over_rows(_add_pairs, len(pairs), world, box, pairs, swapped, *arguments, chunk=1, scratch=work)
        own = tile.pairs[within & (keys_a == keys_b)]  # of a point with itself there is one cell
        none = sums.to_a[:, :, :0]
        arguments = a, b, sums.to_b, none, sums.batches
        over_rows(
            _add_pairs,
            len(own),
            world,
            box,
            own,
            np.zeros(len(own), bool),
            *arguments,
            chunk=1,
            scratch=work,
        )
