"""The records that kernels pass to each other."""

from typing import NamedTuple

import numpy as np

from soundspaces_sim.rays.geometry import Geometry
from soundspaces_sim.transport.detector import Detectors
from soundspaces_sim.transport.surface import Surfaces


class Settings(NamedTuple):
    """Numbers that steer the walks. Lengths in m."""

    walks: int
    specular: int  # walks that only mirror
    joined: int  # of them, walks whose vertices are joined
    kappa: float  # walks / joined (1 when none is joined)
    vv: float  # expected share of vertex pairs drawn per pair of joined walks
    joins_per_vertex: int
    max_bounces: int
    max_length: float
    join_length: float  # paths longer than this are not joined
    join_depth: int  # nor paths with more events
    merging: bool
    late_length: float  # longer paths are merged at patches if they have an event there
    merge_length: float  # events of walks that are longer already are of no use to merges
    meetings: int  # see merge.plan_meetings
    meeting: float
    own_meeting: float
    step: float  # length of an entry of `bin_of_step`
    air_step: float  # length of an entry of `air`


class Walk(NamedTuple):
    """Where a walk stands when it starts a segment."""

    key: int
    segment: int  # counts the segments of all walks of the point
    batch: int
    events: int  # bounces and transmissions so far
    length: float
    p_diffuse: float  # nominal probability of the last bounce if it was diffuse, else 0
    longest: float  # longer paths of this walk are left to merges
    a: float
    b: float
    share: float  # 1 / number of walks


class Walks(NamedTuple):
    """The walks of one batch of one point, advancing together. `state` columns are named below."""

    index: np.ndarray  # (W,) number of the walk among the point's
    stream: np.ndarray  # (W,) uint64, random stream
    hero: np.ndarray  # (W,) proposal that it follows
    state: np.ndarray  # (W, WALK_COLUMNS)
    beta: np.ndarray  # (W, b) weight per band
    mixture: np.ndarray  # (W, h) proposal ratios, see surface.weigh
    first: np.ndarray  # (W, 9) harmonics of the first direction
    scattered: np.ndarray  # (W,) has had a diffuse event
    alive: np.ndarray  # (W,)
    retired: np.ndarray  # (W,) nothing that it still could do is wanted
    share: np.ndarray  # (W,) scratch of `resample`
    copies: np.ndarray  # (W,) scratch of `resample`


class Scratch(NamedTuple):
    """Per-thread working arrays."""

    energy: np.ndarray  # (b,)
    arrival: np.ndarray  # (9,) harmonics of the direction from which the segment arrives
    near: np.ndarray  # (G,) of the detectors' groups


class Job(NamedTuple):
    """What one point's walks need to know about the points that listen."""

    detectors: Detectors
    settings: Settings
    own_section: np.ndarray  # (LEVELS,) cross-section of the walking point's own detector
    early_length: np.ndarray  # (N,) path length that ends the early window of each pair
    bin_of_step: np.ndarray
    air: np.ndarray  # (steps, b) transmission of air against length


class Tables(NamedTuple):
    """Where one point's walks deposit; the first axis is the detector (no bins: not wanted)."""

    arrive: np.ndarray  # (N, bins, 9, b) harmonics of arrival at the detector
    leave: np.ndarray  # (N, bins, 9, b) harmonics of the walk's first direction
    batches: np.ndarray  # (N, BATCHES, WINDOWS, b)


class Vertices(NamedTuple):
    """Vertices of joined walks of N points. `state` columns are named below."""

    state: np.ndarray  # (N, joined, depth, VERTEX_COLUMNS)
    beta: np.ndarray  # (N, joined, depth, b)
    count: np.ndarray  # (N, joined)
    first: np.ndarray  # (N, joined, 9) harmonics of the first direction


class Halves(NamedTuple):
    """Diffuse events on patches, of N points: halves of the paths that `merge` completes."""

    patch: np.ndarray  # (N, capacity)
    length: np.ndarray  # (N, capacity) of the walk, m
    previous: np.ndarray  # (N, capacity) length at the walk's previous such event, -1 for none
    walk: np.ndarray  # (N, capacity)
    beta: np.ndarray  # (N, capacity, b) weight after the event, air included
    count: np.ndarray  # (N,) events met; those beyond the capacity are not stored


class Side(NamedTuple):
    """One point of a pair and its joined walks."""

    point: tuple[float, float, float]
    section: np.ndarray  # (LEVELS,) cross-section of its detector
    state: np.ndarray
    beta: np.ndarray
    count: np.ndarray
    first: np.ndarray


class JoinShared(NamedTuple):
    """What every join needs."""

    geometry: Geometry
    surfaces: Surfaces
    settings: Settings
    levels: Detectors  # for the radius of a path length
    bin_of_step: np.ndarray
    air: np.ndarray
    energy: np.ndarray  # (b,) scratch


class JoinPair(NamedTuple):
    """Where one pair's joins deposit."""

    to_q: np.ndarray  # (bins, 9, b) of p -> q; no bins: not wanted
    to_p: np.ndarray  # (bins, 9, b) of q -> p
    batches: np.ndarray  # (BATCHES, WINDOWS, b)
    early_length: float


class SortedHalves(NamedTuple):
    """Halves of N points, H in all, by (point, patch, length)."""

    keys: np.ndarray  # (N,) of the points
    start: np.ndarray  # (N, C + 1) where each patch starts
    first: np.ndarray  # (N, walks, 9) harmonics of first directions
    length: np.ndarray  # (H,)
    previous: np.ndarray  # (H,)
    walk: np.ndarray  # (H,)
    beta: np.ndarray  # (H, b)


class MergeShared(NamedTuple):
    """What every merge needs."""

    settings: Settings
    weight: np.ndarray  # (C, b) of the patches, all constants included
    bin_of_step: np.ndarray


class MergePair(NamedTuple):
    """Where one pair's merges deposit."""

    to_q: np.ndarray  # (bins, 9 b) of p -> q; no bins: not wanted
    to_p: np.ndarray  # (bins, 9 b) of q -> p
    early_length: float


class MergeWork(NamedTuple):
    """Working arrays of one pair's merges."""

    product: np.ndarray  # (most, 9 b) harmonics times weight of q's halves on a patch
    tiled: np.ndarray  # (most, 9 b) their weight, repeated
    own_product: np.ndarray  # (9 b,) of one half of p
    own_tiled: np.ndarray
    scale: np.ndarray  # (b,)
    one: np.ndarray  # (b,)
    between: np.ndarray  # (BATCHES, BATCHES, WINDOWS, b)


X, Y, Z, NX, NY, NZ, COS_IN, LENGTH, D_VCM, A, B, MATERIAL, EVENTS = range(13)
VERTEX_COLUMNS = 13

# Origin of the next segment relative to the walk's point, its direction, the normal where it starts.
OX, OY, OZ, DX, DY, DZ, WNX, WNY, WNZ, W_VCM, W_A, W_B, W_LENGTH, P_DIFFUSE, W_EVENTS, PREVIOUS = range(
    16
)
WALK_COLUMNS = 16
