"""The records that kernels pass to each other: what is fixed, what subpaths carry, what they leave.

N points of a side, b bands. Structured rows (`VERTEX`) hold what a vertex carries beside its band
weights.
"""

from typing import NamedTuple, Protocol

import numpy as np

from soundspaces_sim.core.numerics.kernel import part
from soundspaces_sim.scene.rays.geometry import Geometry
from soundspaces_sim.transport.bsdf.surface import Surfaces
from soundspaces_sim.transport.paths.detector import Detectors, Radii
from soundspaces_sim.transport.radiance_transfer.patches import Patches

# What is fixed


class Settings(NamedTuple):
    """Numbers that steer the subpaths. Lengths in m."""

    round: int  # subpaths of a round, as the config counts them
    subpaths: int  # that are scattered, and end where radiance transfer begins if it takes part
    specular: int  # subpaths that follow specular reflections alone
    connected: int  # of the scattered ones, those whose vertices are connected
    kappa: float  # subpaths / connected
    vv: float  # expected share of vertex pairs drawn per pair of connected subpaths
    max_bounces: int
    max_length: float
    connection_length: float  # longer paths are not connected; below 0, none is
    connection_depth: int  # nor paths with more events
    radiance_transfer: bool
    late_length: float  # longer paths that are scattered on a patch are radiance transfer's
    step: float  # length of an entry of `bin_of_step`
    air_step: float  # length of an entry of `air`


class World(NamedTuple):
    """A scene under one config, as kernels see it."""

    geometry: Geometry
    surfaces: Surfaces
    patches: Patches
    radii: Radii
    settings: Settings
    bin_of_step: np.ndarray  # (steps,) row of the table for a path length
    window_of_bin: np.ndarray  # (bins,) window of batches, for error bars
    air: np.ndarray  # (steps, b) transmission of air against length


class Ends(NamedTuple):
    """The points on one side of a tile."""

    points: np.ndarray  # (N, 3) relative to the scene's centre
    keys: np.ndarray  # (N,) uint64 of their random streams
    detectors: Detectors


class Tables(NamedTuple):
    """Where the subpaths of some points deposit: (rows, …) for all of them, (…) for one.

    The first axis after that is the detector; a table without bins is not wanted.
    """

    arrive: np.ndarray  # (…, N, bins, 9, b) harmonics of arrival at the detector
    leave: np.ndarray  # (…, N, bins, 9, b) harmonics of the subpath's first direction
    # (…, N, rows, windows, b), `tile.batch_rows`: by batch, and what `deposit_counts` adds
    batches: np.ndarray


# Subpaths

#: A vertex at `x`, `before` its surface of normal `n`, reached in direction `i` after `length` m.
VERTEX = np.dtype(
    [(name, np.float64) for name in "x y z nx ny nz ix iy iz length d_vcm a b".split()]
    + [(name, np.int64) for name in "material events".split()],
    align=True,
)


class VertexRow(Protocol):
    """A row of `VERTEX`, where it lies."""

    x: float
    y: float
    z: float


#: What a point's subpaths count: `reflections` are rows of `ReflectionBlock`; rays and deposits, for the profile.
TALLY = np.dtype([(name, np.int64) for name in ("reflections", "rays", "deposits")])


class Emitters(NamedTuple):
    """P points whose subpaths are traced."""

    points: np.ndarray  # (P, 3) relative to the scene's centre
    keys: np.ndarray  # (P,) uint64 of their random streams
    section: np.ndarray  # (P, LEVELS) m², of their own detectors


def emitters_of(ends: Ends, rows: slice) -> Emitters:
    """Some of a side's points."""
    return Emitters(ends.points[rows], ends.keys[rows], ends.detectors.section[rows])


class Receivers(NamedTuple):
    """What the subpaths of one point need to know about the points that detect them."""

    detectors: Detectors
    own_section: np.ndarray  # (LEVELS,) m², cross-section of the emitting point's own detector


class Scratch(NamedTuple):
    """Per-thread working arrays."""

    energy: np.ndarray  # (b,)
    arrival: np.ndarray  # (9,) harmonics of the direction from which the segment arrives
    near: np.ndarray  # (G,) of the detectors' groups
    tally: np.ndarray  # (1,) TALLY of the point at hand


# What subpaths leave


class Vertices(NamedTuple):
    """Vertices of connected subpaths: (rows, …) of all points, (…) of one."""

    state: np.ndarray  # (…, connected, depth) VERTEX
    beta: np.ndarray  # (…, connected, depth, b)
    count: np.ndarray  # (…, connected)
    first: np.ndarray  # (…, connected, 9) harmonics of the first direction
    counts: np.ndarray  # (…, connected, depth, groups) reflections before it


@part(forceinline=True)
def vertices_of(vertices: Vertices, i: int) -> Vertices:
    """Those of one point."""
    return Vertices(
        vertices.state[i],
        vertices.beta[i],
        vertices.count[i],
        vertices.first[i],
        vertices.counts[i],
    )


class ReflectionBlock(NamedTuple):
    """First diffuse reflections on patches of the subpaths of N points: every patch that a subpath meets.

    The energies of a batch sum to 1 / BATCHES of what patches scatter first of the point's sound, in the mean.
    """

    patch: np.ndarray  # (N, capacity)
    length: np.ndarray  # (N, capacity) m
    subpath: np.ndarray  # (N, capacity) number of the subpath in its batch
    energy: np.ndarray  # (N, capacity, b) scattered there, without air
    counts: np.ndarray  # (N, capacity, groups) reflections before it
    group: np.ndarray  # (N, capacity) group of the surface that scatters, -1 for none
    direction: np.ndarray  # (N, BATCHES, subpaths, 3) in which each subpath left the point
    upto: np.ndarray  # (N, BATCHES) where each batch ends; beyond the capacity nothing is stored
