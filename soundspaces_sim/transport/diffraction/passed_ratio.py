"""The ratio of an edge's field to that of the direct sound that passes it."""

from __future__ import annotations

import math

import numpy as np

from soundspaces_sim.core.numerics.kernel import part
from soundspaces_sim.transport.diffraction.energy import copy_field, detour_taper, reflected_share
from soundspaces_sim.transport.diffraction.passed_edges import PassedScratch
from soundspaces_sim.transport.diffraction.paths import DiffractedPath, beyond_end, edge_shares, terms_of
from soundspaces_sim.transport.diffraction.spectrum import Quadrature
from soundspaces_sim.transport.diffraction.utd import WedgeTerms, wedge_fields


@part
def add_passed(
    e: int,
    path: DiffractedPath,
    quadrature: Quadrature,
    straight: float,
    scratch: PassedScratch,
    found: int,
) -> int:
    """Note an edge that the direct sound of `straight` m passes, after `found` others, or where there is no more
    room in place of the weakest; how many there are then."""
    detour, most, at = path.d_s + path.d_r - straight, 0.0, found
    terms = terms_of(path)
    for b in range(quadrature.k.shape[0]):
        ratio, of_length = scratch.ratio[:, found, b], scratch.of_length[found, b]
        most = max(most, _set_ratio(path, terms, b, quadrature, straight, ratio, of_length))
    if found == len(scratch.edge):
        at = 0
        for m in range(1, found):
            if scratch.size[m] < scratch.size[at]:
                at = m
        if most <= scratch.size[at]:
            return found
        scratch.position[scratch.edge[at]] = -1
        copy_field(scratch.of_length[found], scratch.of_length[at])
        for t in range(3):
            copy_field(scratch.ratio[t, found], scratch.ratio[t, at])
    scratch.edge[at], scratch.share[at], scratch.detour[at] = e, reflected_share(path), detour
    scratch.position[e], scratch.size[at] = at, most
    scratch.beyond[at] = beyond_end(path)
    return min(found + 1, len(scratch.edge))


@part
def _set_ratio(
    path: DiffractedPath,
    terms: WedgeTerms,
    b: int,
    quadrature: Quadrature,
    straight: float,
    ratio: np.ndarray,
    of_length: np.ndarray,
) -> float:
    """Ratios (3, h) of an edge's three terms to the direct sound in a band, and what its length leaves (h) of
    those of reflected waves; the largest sum of their sizes."""
    detour, most = path.d_s + path.d_r - straight, 0.0
    ratio[:, :], of_length[:] = 0j, 0j
    if detour_taper(detour, quadrature.k[b, 0]) <= 0.0:
        return most
    for n in range(quadrature.node.shape[1]):
        fields = wedge_fields(path.n, terms, path.d_s, path.d_r, path.sin_beta, quadrature.node[b, n])
        for h in range(quadrature.k.shape[1]):
            share = quadrature.between[b, h, n]
            for t in range(3):
                ratio[t, h] += share * fields[t]
    for h in range(quadrature.k.shape[1]):
        k, total = quadrature.k[b, h], 0.0
        size = straight * detour_taper(detour, k)
        phase = complex(size * math.cos(k * detour), -size * math.sin(k * detour))
        of_incident, of_reflected = edge_shares(path, k)
        of_length[h] = math.sqrt(path.taper) * of_reflected
        for t in range(3):
            ratio[t, h] *= phase * math.sqrt(path.taper) * (of_incident if t == 0 else of_reflected)
            total += abs(ratio[t, h])
        most = max(most, total)
    return most
