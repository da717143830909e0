"""The state of subpaths under way, and of several that advance together.

A subpath is a path of sound from a point, or from a patch, over surfaces. W subpaths, b bands, h proposals. Vectors
of structured rows are read and written by the functions below (compiled), so that no formula takes them apart.
"""

from typing import NamedTuple, Protocol

import numpy as np

from soundspaces_sim.core.numerics.kernel import part
from soundspaces_sim.core.numerics.rng import combine
from soundspaces_sim.core.numerics.vec3 import Vec3
from soundspaces_sim.transport.paths.mis import PartialSums
from soundspaces_sim.transport.tables import CHANNELS, copy

#: What a subpath carries beside its throughput. Its next segment starts at (ox, oy, oz), m, on a surface of unit
#: normal (nx, ny, nz), in direction (dx, dy, dz); along (ix, iy, iz) it came to that surface, whose `material`
#: scattered it, -1 after a delta lobe and at its start.
PATH = np.dtype(
    [(name, np.float64) for name in "ox oy oz dx dy dz nx ny nz ix iy iz".split()]
    + [
        ("length", np.float64),  # m
        ("d_vcm", np.float64),
        ("a", np.float64),
        ("b", np.float64),  # see `mis.PartialSums`
        ("stream", np.uint64),  # random stream, whose numbers are read by `events`
        ("index", np.int64),  # number among the subpaths of its point
        ("proposal", np.int64),  # that it follows, row of `Surfaces.proposal`
        ("material", np.int64),
        ("events", np.int64),  # reflections and transmissions so far
        ("reflections", np.int64),  # without transmissions; kept by `specular`
        ("next", np.int64),  # next row of what a policy records against length
        ("scattered", np.bool_),  # at least once
        ("first_plane", np.int64),  # of its first reflection; kept by `specular`
        ("by_images", np.bool_),  # only mirrored so far, at planes of image sources; kept by `specular`
        ("back", np.bool_),  # its third reflection was by the plane of the first; kept by `specular`
    ],
    align=True,
)


class SurfaceRow(Protocol):
    """What rows of `PATH` and of `state.VERTEX` have in common."""

    nx: float
    ny: float
    nz: float
    ix: float
    iy: float
    iz: float
    length: float
    d_vcm: float
    a: float
    b: float
    material: int
    events: int


class PathRow(SurfaceRow, Protocol):
    """A row of `PATH`."""

    ox: float
    oy: float
    oz: float
    dx: float
    dy: float
    dz: float
    stream: int
    index: int
    proposal: int
    reflections: int
    next: int
    scattered: bool
    first_plane: int
    by_images: bool
    back: bool


class Paths(NamedTuple):
    """Subpaths that advance together."""

    state: np.ndarray  # (W,) PATH
    beta: np.ndarray  # (W, b) throughput
    mixture: np.ndarray  # (W, h) proposal ratios, see `surface.update_throughput`
    first: np.ndarray  # (W, 9) harmonics of the first direction
    counts: np.ndarray  # (W, groups) reflections so far, by group of materials
    alive: np.ndarray  # (W,)
    retired: np.ndarray  # (W,) nothing that it still could do is wanted
    share: np.ndarray  # (W,) scratch of `population`
    copies: np.ndarray  # (W,) scratch of `population`


def empty_paths(slots: int, bands: int, proposals: int, groups: int = 0) -> Paths:
    """Room for `slots` subpaths, whose reflections are counted in `groups`."""
    return Paths(
        state=np.empty(slots, PATH),
        beta=np.empty((slots, bands)),
        mixture=np.empty((slots, proposals)),
        first=np.empty((slots, CHANNELS)),
        counts=np.zeros((slots, groups), np.uint16),
        alive=np.empty(slots, np.bool_),
        retired=np.empty(slots, np.bool_),
        share=np.empty(slots),
        copies=np.empty(slots, np.int64),
    )


@part(forceinline=True)
def origin_of(state: PathRow) -> Vec3:
    return state.ox, state.oy, state.oz


@part(forceinline=True)
def direction_of(state: PathRow) -> Vec3:
    return state.dx, state.dy, state.dz


@part(forceinline=True)
def normal_of(state: SurfaceRow) -> Vec3:
    """Of the surface at the start of the next segment, or at a vertex."""
    return state.nx, state.ny, state.nz


@part(forceinline=True)
def incident_of(state: SurfaceRow) -> Vec3:
    """Direction along which sound came to that surface."""
    return state.ix, state.iy, state.iz


@part(forceinline=True)
def sums_of(state: SurfaceRow) -> PartialSums:
    return PartialSums(state.d_vcm, state.a, state.b)


@part(forceinline=True)
def put_origin(state: PathRow, origin: Vec3) -> None:
    state.ox, state.oy, state.oz = origin


@part(forceinline=True)
def put_direction(state: PathRow, direction: Vec3) -> None:
    state.dx, state.dy, state.dz = direction


@part(forceinline=True)
def put_normal(state: SurfaceRow, normal: Vec3) -> None:
    state.nx, state.ny, state.nz = normal


@part(forceinline=True)
def put_incident(state: SurfaceRow, direction: Vec3) -> None:
    state.ix, state.iy, state.iz = direction


@part(forceinline=True)
def put_sums(state: SurfaceRow, sums: PartialSums) -> None:
    state.d_vcm, state.a, state.b = sums.d_vcm, sums.a, sums.b


@part(forceinline=True)
def start_path(state: PathRow, origin: Vec3, direction: Vec3) -> None:
    """A subpath that has not met anything."""
    put_origin(state, origin)
    put_direction(state, direction)
    put_normal(state, (0.0, 0.0, 0.0))
    put_incident(state, (0.0, 0.0, 0.0))
    state.length = 0.0
    state.material, state.events, state.reflections, state.next = -1, 0, 0, 0
    state.scattered, state.by_images, state.back, state.first_plane = False, True, False, -1


@part
def copy_path(paths: Paths, source: int, target: int, number: int) -> None:
    """Slot `target` becomes copy `number` of slot `source`, with a random stream of its own; no other copy of the
    source has this number, nor 0 or 1."""
    paths.state[target] = paths.state[source]
    paths.state[target].stream = combine(paths.state[source].stream, number)
    copy(paths.beta[source], paths.beta[target])
    copy(paths.mixture[source], paths.mixture[target])
    copy(paths.first[source], paths.first[target])
    copy(paths.counts[source], paths.counts[target])
    paths.alive[target] = paths.alive[source]
    paths.retired[target] = False
