"""Directions of specular subpaths: where sound of a point lives long without being scattered.

Late sound that was never scattered leaves a point in few directions: after 40 reflections in a furnished flat nine
tenths of it left within a thousandth of the sphere. So first directions are drawn from a density that is learnt for
every point, and weigh its inverse (importance sampling). It is learnt in levels, as rare events are (Kahn & Harris
1951; adaptive multilevel splitting, Cérou & Guyader 2007): pilots of one level, drawn from the density so far,
reach a length up to which enough of them matter; what they carry there is the share of the density that serves that
length, and finds those that matter at the next level. All levels have equal shares, so that the relative error is
about the same over the decay; a part stays uniform over the sphere. Within cells of directions the density is the
square root of the second moment, which makes the variance least (Kahn & Marshall 1953).

Pilots are not used for the estimate itself, so it stays unbiased whatever they find.
"""

import math
from typing import NamedTuple

import numpy as np

from soundspaces_sim.core.numerics.kernel import part
from soundspaces_sim.core.numerics.rng import combine, hashed_uniform
from soundspaces_sim.core.numerics.vec3 import Vec3
from soundspaces_sim.scene.rays.directions import sample_sphere, stratified_pair
from soundspaces_sim.scene.rays.geometry import Hit
from soundspaces_sim.transport.bsdf.sampling import sample_specular
from soundspaces_sim.transport.paths.advance import (
    Limits,
    Policy,
    cos_incidence,
    ignore,
    make_advance,
    spawn_ray,
)
from soundspaces_sim.transport.paths.path_state import Paths, empty_paths, start_path
from soundspaces_sim.transport.state import World

CELLS = 64  # along either coordinate of the sphere
_LEVELS = 5
_UNIFORM = 0.5  # of the density
_MATTER = 0.05  # of the pilots matter, at least, at the length of a level
_FIRST_LOOK = 6.0  # m, and each later one farther by …
_LOOKS_APART = 1.15
_WEAKEST = 1e-7  # of its start, at which a pilot ends
_MOST_UNIFORMTS = 500
_PILOTS = 16  # one for so many specular subpaths of a point, in every level, …
_FEWEST, _MOST = 64, 1024
_STREAM = 0x6D1E


class Guide(NamedTuple):
    """A density on the unit square of `sample_sphere`, uniform in each of n × n cells, with mean 1."""

    density: np.ndarray  # (n, n)
    rows: np.ndarray  # (n + 1,) cumulative
    columns: np.ndarray  # (n, n + 1) cumulative within each row


class Pilots(NamedTuple):
    """A thread's working arrays, for P pilots."""

    looks: np.ndarray  # (K,) m
    carried: np.ndarray  # (P, K, b) weight at every look, 0 after its end
    cell: np.ndarray  # (P, 2)
    paths: Paths  # one slot
    sums: np.ndarray  # (b,)
    curve: np.ndarray  # (K, b) mean energy at every look, of the last level
    moment: np.ndarray  # (3, n, n): of this level, smoothed along a coordinate, of all levels


def empty_guide() -> Guide:
    """Room for a guide."""
    return Guide(np.empty((CELLS, CELLS)), np.empty(CELLS + 1), np.empty((CELLS, CELLS + 1)))


def make_pilots(specular: int, longest: float, bands: int) -> Pilots:
    """For points with so many specular subpaths of up to `longest` m."""
    pilots = min(max(specular // _PILOTS, _FEWEST), _MOST)
    count = max(int(math.log(max(longest / _FIRST_LOOK, 1.0)) / math.log(_LOOKS_APART)) + 1, 1)
    looks = _FIRST_LOOK * _LOOKS_APART ** np.arange(count)
    return Pilots(
        looks=looks,
        carried=np.empty((pilots, count, bands)),
        cell=np.empty((pilots, 2), np.int64),
        paths=empty_paths(1, bands, 0),
        sums=np.empty(bands),
        curve=np.empty((count, bands)),
        moment=np.empty((3, CELLS, CELLS)),
    )


@part
def _invert(cumulative: np.ndarray, u: float) -> tuple[int, float]:
    """(cell, place in [0, 1)) at which a piecewise linear `cumulative` (n + 1,) from 0 to 1 reaches u in [0, 1)."""
    low, high = 0, len(cumulative) - 1
    while high - low > 1:
        middle = (low + high) // 2
        if cumulative[middle] <= u:
            low = middle
        else:
            high = middle
    width = cumulative[low + 1] - cumulative[low]
    return low, min(max((u - cumulative[low]) / width, 0.0), 1.0)


@part
def sample_guided(guide: Guide, u: float, v: float) -> tuple[Vec3, float, tuple[int, int]]:
    """(unit direction, 4 pi times its density, cell) from two uniform numbers; stratified ones stay so."""
    n = len(guide.density)
    i, s = _invert(guide.rows, u)
    j, t = _invert(guide.columns[i], v)
    return sample_sphere((i + s) / n, (j + t) / n), guide.density[i, j], (i, j)


@part
def set_density(guide: Guide) -> None:
    """Scale `guide.density` to a mean of 1, and sum it up."""
    n, total_density = len(guide.density), 0.0
    for i in range(n):
        for j in range(n):
            total_density += guide.density[i, j]
    guide.rows[0] = 0.0
    for i in range(n):
        row = 0.0
        guide.columns[i, 0] = 0.0
        for j in range(n):
            guide.density[i, j] *= n * n / total_density
            row += guide.density[i, j]
            guide.columns[i, j + 1] = row
        for j in range(n):
            guide.columns[i, j + 1] /= row
        guide.columns[i, n] = 1.0
        guide.rows[i + 1] = guide.rows[i] + row / (n * n)
    guide.rows[n] = 1.0


class _Context(NamedTuple):
    """What a pilot knows while it advances."""

    world: World
    pilots: Pilots
    k: int  # its row of `pilots.carried`
    key: int  # of random numbers


@part(forceinline=True)
def _at_surface(context: _Context, paths: Paths, i: int, hit: Hit) -> bool:
    """Note the weights at the looks up to this surface, and go on with what it reflects specularly or transmits."""
    geometry, state, beta = context.world.geometry, paths.state[i], paths.beta[i]
    looks, carried = context.pilots.looks, context.pilots.carried[context.k]
    while state.next < len(looks) and state.length >= looks[state.next]:
        for b in range(len(beta)):
            carried[state.next, b] = beta[b]
        state.next += 1
    if state.next == len(looks):
        return False
    u = hashed_uniform(combine(context.key, state.events), 0)
    material = hit.material
    lobe = sample_specular(context.world.surfaces, material, cos_incidence(state, hit), beta, u)
    if lobe < 0:
        return False
    strongest = 0.0
    for b in range(len(beta)):
        strongest = max(strongest, beta[b])
    v = hashed_uniform(combine(context.key, state.events), 1)
    spawn_ray(geometry, context.world.surfaces, state, hit, lobe, (v, v), beta)
    return strongest > _WEAKEST


_advance = make_advance(Policy(ignore, _at_surface))


@part
def _follow_pilot(world: World, pilots: Pilots, k: int, key: int, origin: Vec3, direction: Vec3) -> None:
    """Fill row `k` of `pilots.carried` with the weights (from 1) that a pilot has at the looks."""
    carried, state = pilots.carried[k], pilots.paths.state[0]
    start_path(state, origin, direction)
    pilots.paths.beta[:] = 1.0
    limits = Limits(math.inf, math.inf, math.inf, _MOST_UNIFORMTS)
    _advance(world.geometry, pilots.paths, 0, limits, _Context(world, pilots, k, key))
    for later in range(state.next, len(pilots.looks)):
        for b in range(carried.shape[1]):
            carried[later, b] = 0.0


@part(forceinline=True)
def _share(pilots: Pilots, k: int, look: int, density: float) -> float:
    """Pilot `k`'s part of what all carry at a look, mean over bands; `pilots.sums` holds what all carry."""
    share, lit = 0.0, 0
    for b in range(len(pilots.sums)):
        if pilots.sums[b] > 0.0:
            lit += 1
            share += pilots.carried[k, look, b] / (density * pilots.sums[b])
    return share / max(lit, 1)


@part
def _number_that_matter(guide: Guide, pilots: Pilots, look: int) -> float:
    """(sum of shares)² / sum of squared shares, at a look; 0 if none carries anything."""
    pilots.sums[:] = 0.0
    for k in range(len(pilots.cell)):
        density = guide.density[pilots.cell[k, 0], pilots.cell[k, 1]]
        for b in range(len(pilots.sums)):
            pilots.sums[b] += pilots.carried[k, look, b] / density
    whole, squares = 0.0, 0.0
    for k in range(len(pilots.cell)):
        share = _share(pilots, k, look, guide.density[pilots.cell[k, 0], pilots.cell[k, 1]])
        whole, squares = whole + share, squares + share * share
    return whole * whole / squares if squares > 0.0 else 0.0


@part
def _add_level(guide: Guide, pilots: Pilots, look: int) -> None:
    """Add to `pilots.moment[2]` the square root of the second moments at a look, of mean 1; `pilots.sums` as
    `_number_that_matter` left it."""
    moment, n = pilots.moment, len(guide.density)
    moment[0] = 0.0
    for k in range(len(pilots.cell)):
        i, j = pilots.cell[k, 0], pilots.cell[k, 1]
        density = guide.density[i, j]
        share = _share(pilots, k, look, density)
        moment[0, i, j] += share * share * density
    for i in range(n):  # binomial, over neighbours; the second coordinate runs round
        for j in range(n):
            above, below = moment[0, max(i - 1, 0), j], moment[0, min(i + 1, n - 1), j]
            moment[1, i, j] = 0.25 * above + 0.5 * moment[0, i, j] + 0.25 * below
    whole = 0.0
    for i in range(n):
        for j in range(n):
            around = moment[1, i, (j - 1) % n] + moment[1, i, (j + 1) % n]
            moment[0, i, j] = math.sqrt(0.5 * moment[1, i, j] + 0.25 * around)
            whole += moment[0, i, j]
    for i in range(n):
        for j in range(n):
            moment[2, i, j] += moment[0, i, j] * n * n / whole


@part
def _note_curve(guide: Guide, pilots: Pilots) -> None:
    """Fill `pilots.curve`."""
    for look in range(len(pilots.looks)):
        for b in range(len(pilots.sums)):
            energy = 0.0
            for k in range(len(pilots.cell)):
                density = guide.density[pilots.cell[k, 0], pilots.cell[k, 1]]
                energy += pilots.carried[k, look, b] / density
            pilots.curve[look, b] = energy / len(pilots.cell)


@part
def specular_energy(pilots: Pilots, length: float, band: int) -> float:
    """What pilots say is left of a point's energy at `length` m without scattering and air; not more than that."""
    look = 0
    while look < len(pilots.looks) - 1 and pilots.looks[look] < length:
        look += 1
    return pilots.curve[look, band]


@part
def learn_guide(world: World, point: Vec3, key: int, guide: Guide, pilots: Pilots) -> None:
    """Fill `guide` for specular subpaths of a point, relative to the scene's centre."""
    key = combine(key, _STREAM)
    guide.density[:] = 1.0
    set_density(guide)
    pilots.moment[2] = 0.0
    last = len(pilots.looks) - 1
    reached = -1
    for level in range(_LEVELS):
        of_level = combine(key, level)
        u0, v0 = hashed_uniform(of_level, 0), hashed_uniform(of_level, 1)
        for k in range(len(pilots.cell)):
            u, v = stratified_pair(k, u0, v0)
            direction, _, (pilots.cell[k, 0], pilots.cell[k, 1]) = sample_guided(guide, u, v)
            _follow_pilot(world, pilots, k, combine(of_level, 2 + k), point, direction)
        _note_curve(guide, pilots)
        look = last
        while look > reached + 1 and _number_that_matter(guide, pilots, look) < _MATTER * len(
            pilots.cell
        ):
            look -= 1
        if _number_that_matter(guide, pilots, look) == 0.0:
            break
        _add_level(guide, pilots, look)
        reached = look
        for i in range(CELLS):
            for j in range(CELLS):
                guide.density[i, j] = _UNIFORM + (1.0 - _UNIFORM) * pilots.moment[2, i, j] / (level + 1)
        set_density(guide)
        if look == last:
            break
