"""Paths by one edge and by two between ends that are points or their images.

Ends come in an order that does not depend on which of them is the source: a pair gives the same bits both ways.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from soundspaces_sim.core.numerics.kernel import part
from soundspaces_sim.core.numerics.vec3 import Vec3, distance
from soundspaces_sim.scene.rays.directions import INV_4PI
from soundspaces_sim.transport.diffraction.corners import past_corners
from soundspaces_sim.transport.diffraction.ends import edge_path, reach_beyond
from soundspaces_sim.transport.diffraction.energy import (
    Interference,
    Wave,
    detour_taper,
    make_wave,
    mean_energy,
    mean_square,
    turn,
    write_factor,
)
from soundspaces_sim.transport.diffraction.passed_edges import (
    BESIDE,
    EdgePair,
    EdgesOfScene,
    PassedScratch,
    make_passed_scratch,
    past_others,
    single_path,
)
from soundspaces_sim.transport.diffraction.passed_in_sight import interference
from soundspaces_sim.transport.diffraction.passed_ratio import add_passed
from soundspaces_sim.transport.diffraction.paths import (
    MAX_DETOUR,
    beyond_end,
    beyond_tolerance,
    faded_in,
    met_point,
    offset_length,
)
from soundspaces_sim.transport.diffraction.seen_ends import (
    SeenEnd,
    clear_rows,
    fewer_wedges,
    mark,
    set_rows,
)
from soundspaces_sim.transport.diffraction.sides_of_faces import BY_BOTH
from soundspaces_sim.transport.diffraction.spectrum import Spectrum
from soundspaces_sim.transport.diffraction.third_edges import with_third_edges
from soundspaces_sim.transport.diffraction.two_edge_path import meets_both, path_length, two_edge_path
from soundspaces_sim.transport.diffraction.two_edge_sight import alone, legs_clear
from soundspaces_sim.transport.diffraction.two_edges import most_energy, two_edge_field
from soundspaces_sim.transport.diffraction.visible_wedges import coordinates_in
from soundspaces_sim.transport.diffraction.wedges import WedgeCoordinates
from soundspaces_sim.transport.path_table import PathSlots, store_wave

_ROUNDING = 1e-9  # m
_MIN_SHARE = 1e-6  # of the free field's energy
_HEARD = 1e-3  # of the energy of the direct sound, below which paths beside it fade


class Between(NamedTuple):
    """Two ends in their order, and where their paths go."""

    first: SeenEnd
    second: SeenEnd
    swapped: bool  # the first is of side b
    lit: bool  # they see each other, or there is the reflection between them
    heard: float  # J/m² in the lowest band, below which a path fades
    nearest: (
        float  # m, least detour by an edge that the same sound passes elsewhere; `MAX_DETOUR` for none
    )
    slots: PathSlots
    number: int  # row of `slots`


class EdgeScratch(NamedTuple):
    """What a thread works in."""

    wave: Wave
    sums: Interference
    passed: PassedScratch
    #: (n,) flags of rows of `MutualVisibility`, to wedges on which sound of the first end has gone on
    continues: np.ndarray


def make_edge_scratch(edges: int, mutual: int, spectrum: Spectrum) -> EdgeScratch:
    """For so many edges, and pairs of them that see each other."""
    shape = spectrum.lit.k.shape
    sums = Interference(np.empty(shape, np.complex128), np.empty(shape))
    passed = make_passed_scratch(edges, spectrum)
    return EdgeScratch(make_wave(shape[0]), sums, passed, np.zeros(mutual, np.bool_))


@part
def _store(
    scene: EdgesOfScene,
    between: Between,
    edges: tuple[int, int],
    at: tuple[Vec3, Vec3],
    length: float,
    scratch: EdgeScratch,
) -> None:
    """Store the path whose wave is in the scratch, unless it is too weak."""
    ends, wave = (between.first.end, between.second.end), scratch.wave
    path = edge_path(scene.sight, ends, between.swapped, edges, at, length, wave.energy)
    most = 0.0
    for b in range(len(wave.energy)):
        most = max(most, wave.energy[b])
    if most < _MIN_SHARE * INV_4PI / (length * length):
        return
    share = faded_in(wave.energy[0], between.heard)
    if share <= 0.0:
        return
    for b in range(len(wave.energy)):
        wave.energy[b] *= share
    store_wave(between.slots, between.number, path, wave.energy, wave.field)


@part
def points_between(
    first: SeenEnd, second: SeenEnd, walls: int, swapped: bool, slots: PathSlots, number: int
) -> Between:
    """Two points of a pair with so many walls between them, that of side b the second unless `swapped`."""
    if swapped:
        first, second = second, first
    straight = distance(first.end.at, second.end.at)
    heard = _HEARD * INV_4PI / (straight * straight) if walls == 0 else 0.0
    return Between(first, second, swapped, walls == 0, heard, MAX_DETOUR, slots, number)


@part
def pair_of(between: Between, scratch: EdgeScratch) -> EdgePair:
    """Both ends with what they see, until `release`."""
    first, second, passed = between.first, between.second, scratch.passed
    set_rows(first, passed.row_a)
    set_rows(second, passed.row_b)
    return EdgePair(first.end, second.end, passed.row_a, passed.row_b, between.lit)


@part
def release(between: Between, scratch: EdgeScratch) -> None:
    """Undo what `pair_of` has noted."""
    clear_rows(between.first, scratch.passed.row_a)
    clear_rows(between.second, scratch.passed.row_b)


@part
def one_edge_paths(
    scene: EdgesOfScene, spectrum: Spectrum, between: Between, pair: EdgePair, scratch: EdgeScratch
) -> tuple[bool, float, float]:
    """Store paths by one edge. In the light: whether edges are passed, whose factor is then in the scratch, and the
    least of their detours, m, or `MAX_DETOUR`, by their lines and by the edges themselves; out of sight, 0."""
    first, second, passed, found = between.first, between.second, scratch.passed, 0
    straight, lit, nearest = distance(pair.p.at, pair.q.at), between.lit, between.nearest
    least = MAX_DETOUR
    dark = EdgePair(pair.p, pair.q, pair.row_p, pair.row_q, False)
    _, wedges, begin, end = fewer_wedges(first, second)
    for beyond in range(2 if lit else 1):  # in the light, by edges that are passed, then by others
        if lit and beyond == 1 and nearest >= MAX_DETOUR:
            break
        for n in range(begin, end):
            e, shadow = wedges[n], not lit or beyond == 1
            own, other = pair.row_p[e], pair.row_q[e]
            if min(own, other) < 0:
                continue
            s, r = coordinates_in(first.visible, own), coordinates_in(second.visible, other)
            if shadow and beyond_tolerance(s, r, offset_length(scene.wedges, e)):
                continue
            if passed.position[e] >= 0:  # on the boundary both would do
                continue
            if not shadow and _path_by(s, r) - straight > MAX_DETOUR + _ROUNDING:
                continue
            ok, path, at = single_path(scene, e, s, r, dark if shadow else pair, between.heard)
            if not ok:
                continue
            path = past_corners(scene.wedges, e, path, (pair.p.at, pair.q.at), lit)
            if not shadow:
                found = add_passed(e, path, spectrum.lit, straight, passed, found)
                detour = max(path.d_s + path.d_r - straight, 0.0)
                nearest, least = min(nearest, detour), min(least, detour + beyond_end(path))
            elif past_others(scene, e, path, dark, between.heard, spectrum.shadow, passed):
                length = distance(pair.p.at, at) + distance(at, pair.q.at)
                if not 0.0 < path.apex < path.edge_length:
                    turn(passed.field[0], spectrum.shadow, length - path.d_s - path.d_r)
                mean_energy(passed.field[0], spectrum.shadow, scratch.wave)
                _fade(lit, nearest, spectrum, scratch)
                _store(scene, between, (e, -1), (at, at), length, scratch)
    if found > 0:
        faint = BESIDE * between.heard
        interference(scene, pair, spectrum.lit, found, faint, passed, scratch.sums)
        write_factor(scratch.sums, spectrum.lit, scratch.wave)
    return found > 0, nearest if lit else 0.0, least if lit else 0.0


@part(forceinline=True)
def _path_by(s: WedgeCoordinates, r: WedgeCoordinates) -> float:
    """Length of the path by the line of an edge between two points about it, m."""
    return math.sqrt((s.r + r.r) ** 2 + (s.z - r.z) ** 2)


@part(forceinline=True)
def _fade(lit: bool, nearest: float, spectrum: Spectrum, scratch: EdgeScratch) -> None:
    """In the light a path round edges fades as do those edges that the straight path passes, `nearest` m: the least
    of their detours."""
    for b in range(len(scratch.wave.energy) if lit else 0):
        scratch.wave.energy[b] *= detour_taper(nearest, spectrum.shadow.k[b, 1])


@part
def nearest_passed(scene: EdgesOfScene, between: Between, pair: EdgePair) -> float:
    """The least detour, m, by an edge that the straight path passes, or `MAX_DETOUR`; 0 out of sight: as
    `one_edge_paths` has it."""
    if not between.lit:
        return 0.0
    first, second = between.first, between.second
    straight, least = distance(pair.p.at, pair.q.at), between.nearest
    _, wedges, begin, end = fewer_wedges(first, second)
    for n in range(begin, end):
        own, other = pair.row_p[wedges[n]], pair.row_q[wedges[n]]
        if min(own, other) < 0:
            continue
        s, r = coordinates_in(first.visible, own), coordinates_in(second.visible, other)
        detour = _path_by(s, r) - straight
        if detour < least and single_path(scene, wedges[n], s, r, pair, 0.0)[0]:
            least = max(detour, 0.0)
    return least


@part
def two_edge_paths(
    scene: EdgesOfScene, spectrum: Spectrum, between: Between, nearest: float, scratch: EdgeScratch
) -> None:
    """Store paths by two edges, of which the first end sees one, and the second the other; what the straight path
    passes is `nearest` m off."""
    if nearest >= MAX_DETOUR:
        return
    mutual, second = scene.mutual, between.second
    mark(mutual, between.first, scratch.continues, True)
    for n in range(second.onward.start[second.row], second.onward.start[second.row + 1]):
        other = second.onward.row[n]
        if scratch.continues[other]:
            e, f = mutual.wedge[other], mutual.wedge[mutual.reverse[other]]
            _two_edge_path(scene, spectrum, between, (e, f), nearest, scratch)
    mark(mutual, between.first, scratch.continues, False)


@part
def _two_edge_path(
    scene: EdgesOfScene,
    spectrum: Spectrum,
    between: Between,
    edges: tuple[int, int],
    nearest: float,
    scratch: EdgeScratch,
) -> None:
    """Store the path by edges e and f, if there is one."""
    wedges, p, q = scene.wedges, between.first.end, between.second.end
    inside, x = two_edge_path(wedges, edges[0], edges[1], p.at, q.at, BY_BOTH, reach_beyond(p, q))
    if not inside:
        return
    if between.heard > 0.0 and most_energy(wedges, x, scene.lowest) < between.heard:
        return
    if not (alone(scene.sight, wedges, x, p, q) and legs_clear(scene.sight, wedges, x, p, q)):
        return
    field, double, shadow = scratch.passed.field[0], scratch.passed.double, spectrum.shadow
    two_edge_field(wedges, x, (False, False), 0.0, between.heard, shadow, double, field)
    if mean_square(field, 0, shadow) * INV_4PI <= between.heard:
        return
    with_third_edges(scene, x, (p, q), between.heard, shadow, scratch.passed)
    length, on_edges = path_length(x), meets_both(wedges, x)
    met_e, met_f = met_point(wedges, x.e, x.z_e), met_point(wedges, x.f, x.z_f)
    at_e = x.at_e if on_edges and p.plane < 0 else met_e
    at_f = x.at_f if on_edges and q.plane < 0 else met_f
    if not on_edges:
        later = distance(p.at, at_e) + distance(at_e, at_f) + distance(at_f, q.at) - length
        turn(field, shadow, later)
        length += later
    mean_energy(field, shadow, scratch.wave)
    _fade(between.lit, nearest, spectrum, scratch)
    _store(scene, between, (x.e, x.f), (at_e, at_f), length, scratch)
