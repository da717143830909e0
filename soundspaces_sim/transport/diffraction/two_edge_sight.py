"""What rays say of a path by two edges: whether its legs are clear, and whether it stands alone.

An end in the light of the edge that is farther from it has a path by that edge alone, to which the path by both is
added (`single`). On the plane of a face rays, which clear edges by their `offset`, and angles may disagree. Then a
path by one edge is one only if both allow it: so every end has the one or the other.
"""

from __future__ import annotations

from soundspaces_sim.core.numerics.kernel import part
from soundspaces_sim.scene.rays.geometry import unoccluded
from soundspaces_sim.transport.diffraction.ends import End, View, sees
from soundspaces_sim.transport.diffraction.paths import apex_point, diffracted_path, in_order, met_point
from soundspaces_sim.transport.diffraction.two_edge_path import TwoEdgePath
from soundspaces_sim.transport.diffraction.wedges import Wedges, wedge_coordinates


@part
def legs_clear(view: View, wedges: Wedges, x: TwoEdgePath, p: End, q: End) -> bool:
    """Whether nothing is in the way of a path by two edges from p to q."""
    clear_e, clear_f = met_point(wedges, x.e, x.z_e), met_point(wedges, x.f, x.z_f)
    return (
        sees(view, p, clear_e) and sees(view, q, clear_f) and unoccluded(view.geometry, clear_e, clear_f)
    )


@part
def _sees_apex(view: View, wedges: Wedges, e: int, end: End, other: End) -> bool:
    """Whether an end sees the apex of the path by edge `e` to another one."""
    s, r = in_order(wedge_coordinates(wedges, e, end.at), wedge_coordinates(wedges, e, other.at))
    path = diffracted_path(wedges.n[e], wedges.length[e], s, r, r.phi)
    return sees(view, end, apex_point(wedges, e, path))


@part
def alone(view: View, wedges: Wedges, x: TwoEdgePath, p: End, q: End) -> bool:
    """Whether there is no path by one of both edges that this one adds to."""
    if x.lit_q and _sees_apex(view, wedges, x.e, q, p):
        return False
    return not (x.lit_p and _sees_apex(view, wedges, x.f, p, q))
