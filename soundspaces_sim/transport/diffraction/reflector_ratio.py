"""What an edge of a reflector adds to its reflection, less what is one with the direct sound."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from soundspaces_sim.core.numerics.kernel import part
from soundspaces_sim.transport.diffraction.energy import detour_taper, reflected_share
from soundspaces_sim.transport.diffraction.paths import DiffractedPath, terms_of
from soundspaces_sim.transport.diffraction.plane_edges import PlaneEdges
from soundspaces_sim.transport.diffraction.utd import reflected_fields
from soundspaces_sim.transport.diffraction.wedges import WedgeCoordinates, Wedges


class Taken(NamedTuple):
    """What the direct sound takes of an edge's reflected terms, where it is shorter by `over` m than the path by
    the edge: `share` of all; and of the other face's, if that is a strip, as it does in `passed_in_sight`."""

    share: float
    over: float
    strip: bool
    later: float  # m, the other face's reflection after the direct sound


@part
def add_ratio(
    path: DiffractedPath,
    k: np.ndarray,
    length: float,
    face: int,
    weight: float,
    taken: Taken,
    ratio: np.ndarray,
) -> None:
    """Add r = p_d / p_mirror of an edge at wave numbers `k` (b, h) to sums (b, h), with this weight, less what is
    `taken`; the reflection by `face` is `length` m."""
    detour, terms = path.d_s + path.d_r - length, terms_of(path)
    for b in range(ratio.shape[0]):
        for h in range(k.shape[1]):
            size = weight * detour_taper(detour, k[b, h]) * length
            if size <= 0.0:
                continue
            direct = detour_taper(taken.over, k[b, h])
            other = share = taken.share * direct
            if taken.strip:
                other = max(share, detour_taper(max(taken.later, 0.0), k[b, h]) * direct)
            phase = k[b, h] * detour
            own, last = reflected_fields(path.n, terms, path.d_s, path.d_r, path.sin_beta, k[b, h])
            if face == 1:
                own, last = last, own
            r = (1.0 - share) * own + (1.0 - other) * last
            ratio[b, h] += r * complex(size * math.cos(phase), -size * math.sin(phase))


@part
def taken_of(
    edges: tuple[Wedges, PlaneEdges],
    e: int,
    about: tuple[WedgeCoordinates, WedgeCoordinates],
    path: DiffractedPath,
    face: int,
    straight: float,
) -> Taken:
    """What the direct sound, `straight` m long, takes of an edge's reflected terms; ends `about` it in order."""
    s, r = about
    sector, dz = math.pi * edges[0].n[e], r.z - s.z
    to_s, to_r = (sector - s.phi, sector - r.phi) if face == 0 else (s.phi, r.phi)  # from the other face
    square = dz * dz + s.r * s.r + r.r * r.r - 2.0 * s.r * r.r * math.cos(to_s + to_r)
    later = 0.0 if max(to_s, to_r) > math.pi else math.sqrt(max(square, 0.0)) - straight
    over = path.d_s + path.d_r - straight
    return Taken(reflected_share(path), over, edges[1].strip[e, 1 - face], later)
