"""Edges of the shape that a mesh is of, whatever its triangles: where planes meet, and where they end.

On a scan no two sides of triangles are on one line, but many triangles are of one plane (`group_planes`).
Each plane's part that is covered is drawn into cells, and small holes are closed. Where two planes meet and both
go on to one side alone, their common line is a crease. Where a plane ends and meets none, the straight parts of
its outline are borders.

Host code (numpy), but for the drawing and for finding which planes meet.
"""

from __future__ import annotations

import math
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from threadpoolctl import threadpool_limits

from soundspaces_sim.core.numerics.kernel import kernel, over_rows, part
from soundspaces_sim.core.numerics.vec3 import Vec3, along, cross, dot, normalize, row
from soundspaces_sim.scene.triangles import areas, corners_of
from soundspaces_sim.transport.arrivals.specular_planes import (
    FACES,
    Cover,
    SpecularPlanes,
    cover_at,
    drawn,
    faces_of_planes,
    flattened,
    group_planes,
    heights,
    in_plane,
    is_rough,
    span,
)

_CLEAR = 4.0  # times the rms stray of a plane's corners: rays along it pass so far off
_CELL = 0.02  # m
_SCANNED = 0.5  # of the area of planes, that is rough: of less, sides of triangles are the edges
_GAP = 0.1  # m: smaller gaps and holes are closed
_HOLE = 0.03  # m²: smaller holes too
_NEAR = 1.25  # cells from a line at which a plane is beside it
_BEYOND = 2.5  # cells from a line at which a plane goes on
_STRAY = 1.5  # cells of an outline from its line
_TURN = np.deg2rad(25.0)  # of an outline's normals from its line's
_CONTACT = 0.04  # m from another plane at which an outline is where both meet
_LEAST_ANGLE = np.deg2rad(20.0)  # between planes that meet
_PARALLEL = 0.98


class Candidate(NamedTuple):
    """A wedge before it is tried where it is open; fields as in `Wedges`."""

    start: np.ndarray
    along: np.ndarray
    length: float
    face: np.ndarray
    normal: np.ndarray
    n: float
    margin: float  # m, how far its pieces stray from its line


class _Sheet(NamedTuple):
    """The part of a plane that is covered."""

    normal: np.ndarray  # (3,)
    offset: float  # m
    margin: float  # m, that its triangles stray, rms
    rough: bool  # its triangles do not lie in planes by themselves, as those that were drawn do
    basis: np.ndarray  # (3, 2)
    corner: np.ndarray  # (2,) m, of the first cell
    covered: np.ndarray  # (nx, ny)
    box: np.ndarray  # (2, 3) m

    def at(self, points: np.ndarray) -> np.ndarray:
        """(n,) whether points (n, 3) near the plane are covered."""
        i, j = np.floor((points @ self.basis - self.corner) / _CELL).astype(np.int64).T
        nx, ny = self.covered.shape
        inside = (i >= 0) & (i < nx) & (j >= 0) & (j < ny)
        return inside & self.covered[np.clip(i, 0, nx - 1), np.clip(j, 0, ny - 1)]


class _Outline(NamedTuple):
    """A straight part of a sheet's outline."""

    start: np.ndarray  # (3,) m
    along: np.ndarray  # (3,) unit
    length: float  # m
    outward: np.ndarray  # (3,) unit


class _Contact(NamedTuple):
    """Where a sheet ends at another one."""

    start: np.ndarray  # (3,) m
    along: np.ndarray  # (3,) unit
    length: float  # m


@threadpool_limits.wrap(limits=1, user_api="blas")  # products are small: threads only wait
def plane_edges(
    vertices: np.ndarray, faces: np.ndarray, beyond: np.ndarray, least: float
) -> tuple[list[Candidate], list[Candidate], int]:
    """(Creases at least so many m long; borders, tried as those of a sheet and as those of either side of a body;
    number of planes). `beyond` (F, 3): see `beyond_sides`."""
    planes = group_planes(vertices, faces, FACES, beyond)
    if not _scanned(vertices, faces, planes):
        return [], [], len(planes.offset)
    sheets = _sheets(vertices, faces, planes)
    creases, contacts = _creases(sheets, least)
    borders = [
        border
        for sheet, own in zip(sheets, contacts, strict=True)
        if sheet.rough
        for outline in _outlines(sheet, least)
        for free in _free(outline, own, least)
        for border in _borders(sheet, free)
    ]
    return creases, borders, len(sheets)


def _scanned(vertices: np.ndarray, faces: np.ndarray, planes: SpecularPlanes) -> bool:
    """Whether most of the area of planes is rough."""
    of_plane, rough, whole = planes.of_face, 0.0, 0.0
    own, start = faces_of_planes(of_plane, len(planes.offset))
    for p, (low, high) in enumerate(pairwise(start)):
        triangles = corners_of(vertices, faces[own[low:high]])
        area = float(areas(triangles).sum())
        whole += area
        rough += area if is_rough(heights(triangles, planes.normal[p]) - planes.offset[p]) else 0.0
    return whole > 0.0 and rough >= _SCANNED * whole


def _sheets(vertices: np.ndarray, faces: np.ndarray, planes: SpecularPlanes) -> list[_Sheet]:
    own, start = faces_of_planes(planes.of_face, len(planes.offset))
    out = []
    for p, (low, high) in enumerate(pairwise(start)):
        corners = corners_of(vertices, faces[own[low:high]])
        n, d = planes.normal[p], planes.offset[p]
        basis = in_plane(n)
        corner, covered = drawn(flattened(corners, basis), _CELL, 2.0 * _GAP)
        stray = heights(corners, n) - d
        margin = float(np.sqrt((stray * stray).mean()))
        sheet = _Sheet(
            n,
            float(d),
            margin,
            is_rough(stray),
            basis.T,
            corner,
            _closed(covered),
            np.stack(span(corners)),
        )
        out.append(sheet)
    return out


def _closed(covered: np.ndarray) -> np.ndarray:
    """Without small gaps and holes."""
    from scipy import ndimage  # readers of datasets do without it

    half = round(0.5 * _GAP / _CELL)
    size = 2 * half + 1
    wide = ndimage.maximum_filter(covered, size)
    covered = covered | ndimage.minimum_filter(wide, size)
    hole, _ = ndimage.label(~covered)
    small = np.bincount(hole.ravel()) < _HOLE / _CELL**2
    return np.asarray(covered | small[hole])


def _runs(flags: np.ndarray, gap: int, least: int) -> list[tuple[int, int]]:
    """(First, last + 1) of runs of true flags, in which shorter gaps are closed."""
    change = np.flatnonzero(np.diff(np.concatenate([[False], flags, [False]]).astype(np.int8)))
    runs: list[tuple[int, int]] = []
    for low, high in change.reshape(-1, 2).tolist():
        if runs and low - runs[-1][1] <= gap:
            runs[-1] = runs[-1][0], high
        else:
            runs.append((low, high))
    return [(low, high) for low, high in runs if high - low >= least]


def _creases(sheets: list[_Sheet], least: float) -> tuple[list[Candidate], list[list[_Contact]]]:
    """(Creases of two sheets, and for each sheet where it ends at others)."""
    contacts: list[list[_Contact]] = [[] for _ in sheets]
    if len(sheets) < 2:
        return [], contacts
    normal, offset = np.array([s.normal for s in sheets]), np.array([s.offset for s in sheets])
    low, high = np.array([s.box[0] for s in sheets]), np.array([s.box[1] for s in sheets])
    near = ((low[:, None] < high + _CONTACT) & (low < high[:, None] + _CONTACT)).all(axis=2)
    near &= np.abs(normal @ normal.T) < np.cos(_LEAST_ANGLE)
    rough = np.array([s.rough for s in sheets])
    near &= rough[:, None] | rough  # others have edges by their triangles' sides
    creases: list[Candidate] = []
    pairs = np.argwhere(np.triu(near, 1))
    places = np.zeros(len(pairs), np.int64)
    over_rows(_count_meetings, len(pairs), _cover_of(sheets), normal, offset, low, high, pairs, places)
    for a, b in pairs[places >= round(_GAP / _CELL)].tolist():
        one, other = sheets[a], sheets[b]
        along = np.cross(normal[a], normal[b])
        along /= np.linalg.norm(along)
        at = np.linalg.solve(np.array([normal[a], normal[b], along]), [offset[a], offset[b], 0.0])
        z0, z1 = _within(
            at, along, np.maximum(low[a], low[b]) - _CONTACT, np.minimum(high[a], high[b]) + _CONTACT
        )
        if z1 - z0 < least:
            continue
        z = np.arange(z0, z1, _CELL)
        line = at + z[:, None] * along
        beside = [_sides(sheet, line, along) for sheet in (one, other)]
        gap, few = round(_GAP / _CELL), round((least - _CELL) / _CELL)
        for sheet, k in ((a, 0), (b, 1)):
            ends = beside[k].plus ^ beside[k].minus
            for i, j in _runs(ends & beside[1 - k].touched, gap, gap):
                contacts[sheet].append(_Contact(line[i], along, float(z[j - 1] - z[i])))
        for sign_a in (1.0, -1.0):
            for sign_b in (1.0, -1.0):
                flags = beside[0].ends(sign_a) & beside[1].ends(sign_b)
                for i, j in _runs(flags, gap, few):
                    face = sign_a * beside[0].across
                    second = sign_b * beside[1].across
                    between = float(np.arccos(np.clip(face @ second, -1.0, 1.0)))
                    away = second - (second @ face) * face  # the open sector is on the other side
                    n = 2.0 - between / np.pi
                    clear = _CLEAR * max(one.margin, other.margin)
                    creases.append(
                        Candidate(
                            line[i] - 0.5 * _CELL * along, along, float(z[j - 1] - z[i] + _CELL), face,
                            -away / np.linalg.norm(away), n, clear / np.sin(0.5 * np.pi * n),
                        )
                    )  # fmt: skip
    return creases, contacts


def _cover_of(sheets: list[_Sheet]) -> Cover:
    """The cells of all sheets."""
    shape = np.array([sheet.covered.shape for sheet in sheets], np.int64)
    return Cover(
        np.array([sheet.basis.T for sheet in sheets]),
        np.array([sheet.corner for sheet in sheets]),
        np.full(len(sheets), _CELL),
        shape,
        np.append(0, np.cumsum(shape.prod(axis=1)))[:-1],
        np.concatenate([sheet.covered.astype(np.uint8).ravel() for sheet in sheets]),
    )


@part
def _touched(cover: Cover, a: int, x: Vec3, across: Vec3) -> bool:
    """Whether a sheet is beside a place on a line in its plane."""
    for k in (-_BEYOND, -_NEAR, _NEAR, _BEYOND):
        if cover_at(cover, a, along(x, k * _CELL, across)) > 0:
            return True
    return False


@kernel
def _count_meetings(
    first: int,
    last: int,
    cover: Cover,
    normal: np.ndarray,
    offset: np.ndarray,
    low: np.ndarray,
    high: np.ndarray,
    pairs: np.ndarray,
    places: np.ndarray,
) -> None:
    """At how many places, a cell apart, both sheets of pairs (n, 2) are beside their common line."""
    for i in range(first, last):
        a, b = pairs[i]
        n_a, n_b = row(normal, a), row(normal, b)
        v = normalize(cross(n_a, n_b))
        # The point of both planes that is nearest to the origin.
        cos = dot(n_a, n_b)
        over = 1.0 / (1.0 - cos * cos)
        c_a, c_b = (offset[a] - cos * offset[b]) * over, (offset[b] - cos * offset[a]) * over
        at = along((c_a * n_a[0], c_a * n_a[1], c_a * n_a[2]), c_b, n_b)
        z0, z1 = -math.inf, math.inf
        for k in range(3):
            step = v[k] if abs(v[k]) > 1e-9 else 1e-9
            one = (max(low[a, k], low[b, k]) - _CONTACT - at[k]) / step
            other = (min(high[a, k], high[b, k]) + _CONTACT - at[k]) / step
            z0, z1 = max(z0, min(one, other)), min(z1, max(one, other))
        for n in range(max(int((z1 - z0) / _CELL) + 1, 0)):
            x = along(at, z0 + n * _CELL, v)
            if _touched(cover, a, x, cross(n_a, v)) and _touched(cover, b, x, cross(n_b, v)):
                places[i] += 1


def _within(at: np.ndarray, along: np.ndarray, low: np.ndarray, high: np.ndarray) -> tuple[float, float]:
    """From where to where a line is in a box, m; the first is larger if it is not."""
    step = np.where(np.abs(along) < 1e-9, 1e-9, along)
    ends = np.stack([(low - at) / step, (high - at) / step])
    return float(ends.min(axis=0).max()), float(ends.max(axis=0).min())


class _Beside(NamedTuple):
    """What a sheet does beside a line in its plane, at n places."""

    across: np.ndarray  # (3,) unit, in the plane, normal to the line
    plus: np.ndarray  # (n,) it is on the one side
    minus: np.ndarray  # (n,) it is on the other side
    touched: np.ndarray  # (n,) it is on any side

    def ends(self, sign: float) -> np.ndarray:
        """(n,) it is on the side of this sign alone."""
        return self.plus & ~self.minus if sign > 0.0 else self.minus & ~self.plus


def _sides(sheet: _Sheet, line: np.ndarray, along: np.ndarray) -> _Beside:
    across = np.cross(sheet.normal, along)
    at = {k: sheet.at(line + k * _CELL * across) for k in (-_BEYOND, -_NEAR, _NEAR, _BEYOND)}
    plus, minus = at[_NEAR] & ~at[-_BEYOND], at[-_NEAR] & ~at[_BEYOND]
    through = at[_BEYOND] & at[-_BEYOND]
    return _Beside(across, plus & ~minus, minus & ~plus, through | at[_NEAR] | at[-_NEAR])


def _outlines(sheet: _Sheet, least: float) -> list[_Outline]:
    """The straight parts of a sheet's outline, fitted one by one, that of most cells first."""
    from scipy import ndimage  # readers of datasets do without it

    covered = sheet.covered
    rim = covered & ~ndimage.minimum_filter(covered, 3)
    i, j = np.nonzero(rim)
    smooth = ndimage.gaussian_filter(covered.astype(np.float32), 2.0)
    gx, gy = (ndimage.sobel(smooth, axis)[i, j] for axis in (0, 1))
    size = np.hypot(gx, gy)
    outward = -np.stack([gx, gy], axis=1) / np.maximum(size, 1e-9)[:, None]
    x = (np.column_stack([i, j]) + 0.5) * _CELL + sheet.corner
    left = size > 1e-6
    step = np.deg2rad(10.0)
    turn = np.round(np.arctan2(outward[:, 1], outward[:, 0]) / step) % 36
    towards = np.column_stack([np.cos(turn * step), np.sin(turn * step)])
    bins = np.round((x * towards).sum(axis=1) / _CELL).astype(np.int64)
    key = np.unique(turn.astype(np.int64) * 1_000_000 + bins, return_inverse=True)[1]
    few = (least - 2.0 * _CELL) / _CELL
    out: list[_Outline] = []
    for _ in range(len(x)):
        count = np.bincount(key[left], minlength=1)
        if count.max(initial=0) < 0.3 * few:
            break
        best = count.argmax()
        first = np.flatnonzero(left & (key == best))
        members, u = first, towards[first[0]]
        for _ in range(8):
            d = np.median(x[members] @ u)
            near = left & (np.abs(x @ u - d) < _STRAY * _CELL) & (outward @ u > np.cos(_TURN))
            fresh = np.flatnonzero(near)
            if len(fresh) < 3:
                break
            centred = x[fresh] - x[fresh].mean(axis=0)
            _, vectors = np.linalg.eigh(centred.T @ centred)
            v = vectors[:, 0] * np.sign(vectors[:, 0] @ u)
            same = len(fresh) == len(members) and (fresh == members).all()
            members, u = fresh, v if v @ u > 0.5 else u
            if same:
                break
        left[first] = False
        left[members] = False
        d = (x[members] @ u).mean()
        t = np.array([-u[1], u[0]])
        z = np.sort(x[np.abs(x @ u - d) < _STRAY * _CELL] @ t)
        for run in np.split(z, np.flatnonzero(np.diff(z) > _GAP) + 1):
            own = x[members] @ t
            inside = own[(own >= run[0]) & (own <= run[-1])]
            if run[-1] - run[0] < least - 2.0 * _CELL or len(inside) < 0.5 * (run[-1] - run[0]) / _CELL:
                continue
            in_space = sheet.basis @ (d * u + run[0] * t) + sheet.offset * sheet.normal
            out.append(_Outline(in_space, sheet.basis @ t, float(run[-1] - run[0]), sheet.basis @ u))
    return out


def _free(outline: _Outline, contacts: list[_Contact], least: float) -> list[_Outline]:
    """The parts of an outline that are not where its sheet meets another."""
    z = np.arange(0.0, outline.length + 0.5 * _CELL, _CELL)
    line = outline.start + z[:, None] * outline.along
    free = np.ones(len(z), bool)
    for contact in contacts:
        if abs(contact.along @ outline.along) < _PARALLEL:
            continue
        to = line - contact.start
        at = to @ contact.along
        off = np.linalg.norm(to - at[:, None] * contact.along, axis=1)
        free &= (off > _CONTACT) | (at < -_CONTACT) | (at > contact.length + _CONTACT)
    return [
        outline._replace(start=line[i], length=float(z[j - 1] - z[i]))
        for i, j in _runs(free, 0, round((least - _CELL) / _CELL))
    ]


def _borders(sheet: _Sheet, border: _Outline) -> list[Candidate]:
    """A border as that of a sheet, and as that of a body on either side of it: rays find which it is."""
    clear = _CLEAR * sheet.margin
    tried = (
        (1.0, 2.0, clear + 0.5 * _CELL),
        (1.0, 1.5, np.sqrt(2.0) * clear),
        (-1.0, 1.5, np.sqrt(2.0) * clear),
    )
    return [
        Candidate(
            border.start, border.along, border.length, -border.outward, sign * sheet.normal, n, margin
        )
        for sign, n, margin in tried
    ]
