"""Recursive multiple importance sampling: the balance heuristic with sample counts.

A path from p to q over vertices x_1 .. x_k can be made by k + 3 estimators. In units of the number of connected
subpaths per point, estimator t is sampled n_t times:

    a subpath of p passes q's receiver volume, or q's passes p's   n = kappa = subpaths / connected subpaths
    vertex x_k of p's subpath to q, or x_1 of q's subpath to p     n = 1
    vertex x_i of p's subpath to x_{i+1} of q's                    n = vv, the mean share of vertex pairs drawn

The weight of estimator t is n_t p_t / sum_u n_u p_u (Veach 1997, section 9.2). A subpath carries what the sum needs
(Georgiev 2012, Implementing vertex connection and merging, section 4; the factor `vv` and the split of d_vc are
ours). An estimator that needs a connection at a delta lobe, or whose path is too long or too deep to be connected
at all, has count zero: its term is left out. Both rules depend on the path alone.

Densities `_w` are per steradian; eta is the mean cross-section, m², of a point's receiver volume.
"""

import math
from typing import NamedTuple

from soundspaces_sim.core.numerics.kernel import part
from soundspaces_sim.scene.rays.directions import INV_4PI

_4PI = 4.0 * math.pi


class PartialSums(NamedTuple):
    """What a subpath carries of the balance heuristic's denominator, relative to its own density."""

    d_vcm: float  # 1 / density of the last step, times the count of the estimator that connects there
    a: float  # d_vc = a + eta b: a sums the estimators that connect earlier, …
    b: float  # … b is the one in which the other subpath passes this point's own receiver volume, of section eta.
    # Eta depends on the length of the whole path, so it enters when the path is closed.


class Closing(NamedTuple):
    """The step that closes a path, from its last vertex to the other point."""

    forward_w: float  # density towards the point
    reverse_w: float  # of the same event on the reversed path
    cos_out: float
    distance2: float  # m²


@part
def start(kappa: float) -> PartialSums:
    """Of a subpath that leaves its point uniformly."""
    return PartialSums(_4PI, 0.0, _4PI * kappa)


@part(forceinline=True)
def arrive(sums: PartialSums, distance: float, cos_in: float, count: float) -> PartialSums:
    """After a step of `distance` to a surface; `count` is n of a connection across that step."""
    d_vcm, a, b = sums
    return PartialSums(d_vcm * count * distance * distance / cos_in, a / cos_in, b / cos_in)


@part(forceinline=True)
def leave_scatter(sums: PartialSums, forward_w: float, reverse_w: float, cos_out: float) -> PartialSums:
    """After a scattering event, of these densities (forward, and of the reversed path)."""
    d_vcm, a, b = sums
    scale = cos_out / forward_w
    return PartialSums(1.0 / forward_w, scale * (a * reverse_w + d_vcm), scale * b * reverse_w)


@part(forceinline=True)
def leave_delta(sums: PartialSums, cos_in: float) -> PartialSums:
    """After specular reflection or straight transmission."""
    return PartialSums(0.0, sums.a * cos_in, sums.b * cos_in)


@part(forceinline=True)
def weight_receiver_volume(
    sums: PartialSums,
    vertex_term: float,
    eta_own: float,
    eta_other: float,
    kappa: float,
    connectable: bool,
) -> float:
    """Of a subpath that passes the other point's receiver volume; `vertex_term` = distance² / density of its last
    step."""
    others = eta_own * sums.b * INV_4PI
    if connectable:
        others += vertex_term + sums.a * INV_4PI
    return 1.0 / (1.0 + others / (kappa * eta_other))


@part(forceinline=True)
def weight_vertex_to_point(
    sums: PartialSums, closing: Closing, eta_own: float, eta_other: float, kappa: float
) -> float:
    """Of a vertex that is connected to the other point."""
    d_vcm, a, b = sums
    from_other_a = INV_4PI * closing.cos_out / closing.distance2
    return 1.0 / (
        1.0
        + kappa * eta_other * closing.forward_w / closing.distance2
        + from_other_a * (d_vcm + (a + eta_own * b) * closing.reverse_w)
    )


@part(forceinline=True)
def connection_term(sums: PartialSums, reverse_w: float, eta_own: float, from_other_a: float) -> float:
    """One side's part of the denominator of `weight_vertex_to_vertex`; `from_other_a`: density, 1/m², with which
    the other side's subpath comes to this vertex."""
    d_vcm, a, b = sums
    return from_other_a * (d_vcm + (a + eta_own * b) * reverse_w)


@part(forceinline=True)
def weight_vertex_to_vertex(term_x: float, term_y: float, vv: float) -> float:
    """Of a vertex that is connected to a vertex of the other point's subpath."""
    return vv / (vv + term_x + term_y)
