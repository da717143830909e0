"""Recursive multiple importance sampling: the balance heuristic with sample counts.

A path from p to q over vertices x_1 .. x_k can be made by k + 3 techniques. In units of the number of
joined walks per point, technique t is sampled n_t times:

    walk of p passes q's detector, or of q passes p's    n = kappa = walks / joined walks
    vertex x_k of p's walk to q, or x_1 of q's walk to p  n = 1
    vertex x_i of p's walk to x_{i+1} of q's              n = vv, the mean share of vertex pairs drawn

The weight of technique t is n_t p_t / sum_u n_u p_u. A walk carries what the sum needs (Georgiev 2012,
section 4; the factor `vv` and the split of d_vc are ours):

    d_vcm       1 / pdf of the last step, times the count of the technique that joins there
    d_vc        A + eta * B: A sums the techniques that join earlier, B the one in which the other
                walk passes this walk's own detector of cross-section eta. eta depends on the length of
                the whole path, so it enters when the path is closed.

A technique that needs a join at a delta lobe, or whose path is too long or too deep to be joined at
all, has count zero: its term is left out. Both rules depend on the path alone.
"""

import math

from soundspaces_sim.core.numerics.kernel import part
from soundspaces_sim.scene.rays.directions import INV_4PI

_4PI = 4.0 * math.pi


@part
def start(kappa):
    """(d_vcm, A, B) of a walk that leaves its point uniformly."""
    return _4PI, 0.0, _4PI * kappa


@part(forceinline=True)
def arrive(d_vcm, a, b, distance, cos_in, count):
    """After a step of `distance` to a surface; `count` is n of a join across that step."""
    return d_vcm * count * distance * distance / cos_in, a / cos_in, b / cos_in


@part(forceinline=True)
def leave_scatter(d_vcm, a, b, forward_w, reverse_w, cos_out):
    """After a scattering bounce, of these densities per steradian (forward, and of the reversed path)."""
    scale = cos_out / forward_w
    return 1.0 / forward_w, scale * (a * reverse_w + d_vcm), scale * b * reverse_w


@part(forceinline=True)
def leave_delta(a, b, cos_in):
    """After a mirror bounce or straight transmission."""
    return 0.0, a * cos_in, b * cos_in


@part(forceinline=True)
def weight_hit(a, b, vertex_term, eta_own, eta_other, kappa, joinable):
    """A walk passes the other point's detector. `vertex_term` = distance^2 / pdf_w of its last step."""
    others = eta_own * b * INV_4PI
    if joinable:
        others += vertex_term + a * INV_4PI
    return 1.0 / (1.0 + others / (kappa * eta_other))


@part(forceinline=True)
def weight_vertex_to_end(
    d_vcm, a, b, forward_w, reverse_w, cos_out, distance2, eta_own, eta_other, kappa
):  # fmt: skip
    """A vertex joined to the other point; densities per steradian towards it, and of the reversed path."""
    from_other_a = INV_4PI * cos_out / distance2
    return 1.0 / (
        1.0
        + kappa * eta_other * forward_w / distance2
        + from_other_a * (d_vcm + (a + eta_own * b) * reverse_w)
    )


@part(forceinline=True)
def join_term(d_vcm, a, b, reverse_w, eta_own, from_other_a):
    """One side's part of the denominator of `weight_vertex_to_vertex`; `from_other_a`: density per m² with
    which the other side's walk comes to this vertex."""
    return from_other_a * (d_vcm + (a + eta_own * b) * reverse_w)


@part(forceinline=True)
def weight_vertex_to_vertex(term_x, term_y, vv):
    """A vertex joined to a vertex of the other point's walk."""
    return vv / (vv + term_x + term_y)
