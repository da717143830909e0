"""Edges' mirror images in planes on which a face of theirs stands: the floor below a box, the wall behind it.

A body that stands on a plane is one of twice the height in free air, with both ends and their images. An edge e and
its image e' bound one face of that body, so sound also goes from an end by e' and e. In the room it goes by e, down
the face, by the plane, and up again to e. An end in the room sees e' if its image sees e, and the image if the end
itself does.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from soundspaces_sim.core.numerics.kernel import kernel, over_rows, part
from soundspaces_sim.core.numerics.vec3 import Vec3, along, negate
from soundspaces_sim.scene.rays.geometry import Geometry, cast_ray
from soundspaces_sim.transport.diffraction.ends import End, View, image_end, reflected, sees
from soundspaces_sim.transport.diffraction.paths import met_point, offset_length, on_edge
from soundspaces_sim.transport.diffraction.plane_edges import face_directions
from soundspaces_sim.transport.diffraction.sides_of_faces import face_normal
from soundspaces_sim.transport.diffraction.wedges import Wedges, edge_point
from soundspaces_sim.transport.image_source.specular_planes import SpecularPlanes

MIN_DISTANCE = 0.06  # m: an edge nearer to a plane is part of it
_RIGHT_ANGLE = 0.01  # rad, that a face may lean and an edge may rise
_NEAR = 0.02  # m, from a face, at which rays to it start
_FOOT = 0.005  # m, over a plane, at which a face still has to be there
_TRIED = np.array([1.0 / 6.0, 0.5, 5.0 / 6.0])  # shares of an edge's length
_HEIGHTS = 8  # between an edge and the plane, at which a face has to be there


class MirroredEdges(NamedTuple):
    """Mirror images of E edges: rows start[e]:start[e + 1] are those of edge e. Row m is the wedge E + m."""

    start: np.ndarray  # (E + 1,)
    plane: np.ndarray  # (M,)


class _Candidates(NamedTuple):
    """Faces that may stand on a plane."""

    edge: np.ndarray  # (n,)
    face: np.ndarray  # (n,) 0, 1: which of the edge's
    height: np.ndarray  # (n,) m, of the edge over the plane


@kernel
def _try_faces(
    first: int, last: int, geometry: Geometry, wedges: Wedges, faces: _Candidates, stands: np.ndarray
) -> None:
    """Flags (n,): wherever it is tried there is a face from its edge down to the plane."""
    for i in range(first, last):
        e = faces.edge[i]
        u, n = face_directions(wedges, e, faces.face[i])
        reach = 2.0 * _NEAR + offset_length(wedges, e)
        stands[i] = True
        for k in range(len(_TRIED)):
            for h in range(_HEIGHTS + 1):
                down = (
                    (h + 0.5) / _HEIGHTS * faces.height[i] if h < _HEIGHTS else faces.height[i] - _FOOT
                )
                at = along(edge_point(wedges, e, _TRIED[k] * wedges.length[e]), down, u)
                if cast_ray(geometry, along(at, _NEAR, n), negate(n), reach)[1] < 0:
                    stands[i] = False


def _candidates(
    wedges: Wedges, planes: SpecularPlanes, large: np.ndarray
) -> tuple[_Candidates, np.ndarray]:
    """(Faces at a right angle on `large` (P,) planes, their edges parallel to these; the planes (n,))."""
    sector, normal = np.pi * wedges.n[:, None], planes.normal.T
    second = np.cos(sector) * wedges.face + np.sin(sector) * wedges.normal
    height = wedges.start @ normal - planes.offset  # (E, P)
    far = (wedges.start + wedges.length[:, None] * wedges.along) @ normal - planes.offset
    wanted = large & (np.abs(wedges.along @ normal) < np.sin(_RIGHT_ANGLE))
    wanted &= np.minimum(np.abs(height), np.abs(far)) > MIN_DISTANCE + planes.margin
    towards = -np.sign(height)
    meets = np.array(
        [wanted & (u @ normal * towards > np.cos(_RIGHT_ANGLE)) for u in (wedges.face, second)]
    )
    # Columns of one array as `nonzero` has them, so of another layout for one face, another type for kernels.
    face, edge, plane = map(np.ascontiguousarray, np.nonzero(meets))
    return _Candidates(edge, face, np.abs(height[edge, plane])), plane


def with_mirrored(
    geometry: Geometry, wedges: Wedges, planes: SpecularPlanes, large: np.ndarray
) -> tuple[Wedges, MirroredEdges]:
    """E wedges and, after them, the mirror images in `large` (P,) planes of those that stand on them."""
    faces, plane = _candidates(wedges, planes, large)
    stands = np.zeros(len(plane), np.bool_)
    over_rows(_try_faces, len(plane), geometry, wedges, faces, stands)
    # of a plate both faces stand there
    edge, plane = map(np.ascontiguousarray, np.unique(np.stack([faces.edge, plane])[:, stands], axis=1))
    own, n = Wedges(*(column[edge] for column in wedges)), planes.normal[plane]

    def turned(v: np.ndarray, offset: float | np.ndarray = 0.0) -> np.ndarray:
        return np.asarray(v - 2.0 * ((v * n).sum(axis=1) - offset)[:, None] * n)

    directions = {name: turned(getattr(own, name)) for name in ("along", "face", "normal", "offset")}
    images = own._replace(start=turned(own.start, planes.offset[plane]), **directions)
    start = np.searchsorted(edge, np.arange(len(wedges.length) + 1))
    both = (np.concatenate(columns) for columns in zip(wedges, images, strict=True))
    return Wedges(*both), MirroredEdges(start, plane)


def real_wedges(wedges: Wedges, mirrored: MirroredEdges) -> Wedges:
    """Those of `with_mirrored` that are no mirror images."""
    return Wedges(*(column[: len(mirrored.start) - 1] for column in wedges))


@part(forceinline=True)
def _beside_face(wedges: Wedges, e: int, phi: float, z: float) -> Vec3:
    """Where a path meets an edge whose line it meets at `z` m, moved off its face at the angle `phi` as far as rays
    need."""
    at = edge_point(wedges, e, on_edge(wedges, e, z))
    return along(at, offset_length(wedges, e), face_normal(wedges, e, phi))


@part
def sees_mirrored(
    view: View,
    wedges: Wedges,
    mirrored: tuple[int, int],
    end: End,
    z: tuple[float, float],
    phi: float,
    share: np.ndarray,
) -> bool:
    """Whether sound goes from an end by the image of an edge, (edge, plane), at z[0] m, and along the face at the
    angle `phi` to the edge, at z[1] m. Into `share[0]` (b,) the energy that planes leave it, over that which they
    leave what goes straight to the edge; 0 if that has none. `share` (2, b)."""
    e, plane = mirrored
    if end.plane >= 0 and end.plane != plane:
        return False
    other, place = image_end(view, plane, end.point), met_point(wedges, e, z[0])
    if end.plane >= 0:
        other = End(end.point, end.point, -1)
    if not (sees(view, other, place) and sees(view, end, met_point(wedges, e, z[1]))):
        return False
    foot, top = (
        image_end(view, plane, _beside_face(wedges, e, phi, z[0])),
        _beside_face(wedges, e, phi, z[1]),
    )
    if not sees(view, foot, top):
        return False
    share[:, :] = 1.0
    reflected(view, foot, top, share[0])
    reflected(view, other, place, share[0])
    reflected(view, end, met_point(wedges, e, z[1]), share[1])
    for b in range(share.shape[1]):
        share[0, b] = share[0, b] / share[1, b] if share[1, b] > 0.0 else 0.0
    return True
