"""Derivatives of radiance transfer's energies by what materials reflect and scatter, for the very subpaths.

Energies are bilinear, E = ⟨V, F⟩ (the package's docstring). With V' and F' the histograms of the same events, each
times the derivative of the logarithm of its energy,

    dE = ⟨V', F⟩ + ⟨V, F'⟩.

An event that group m has reflected n times carries ρ_m^n, so that by ln ρ_m this derivative is n. By scattering it
is the event's score.

V has the reflection on the patch. F has the patch's ρs as well, over R, the integral of ρs over the patch: R's own
derivative is taken off, so that a reflection on a patch of one material counts once. So it is with
the place from which a transfer subpath sets out, which has ρs over R, too. Held constant are what is drawn (which
reflections are carried on, these places, populations) and the decay by which energies are compensated.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from threadpoolctl import threadpool_limits

from soundspaces_sim.core.numerics.kernel import kernel, over_rows
from soundspaces_sim.core.numerics.rng import combine
from soundspaces_sim.core.numerics.vec3 import negate
from soundspaces_sim.core.numerics.vec3 import row as row_of
from soundspaces_sim.core.profile import stage
from soundspaces_sim.scene.rays.geometry import lifted, material_met
from soundspaces_sim.transport.bsdf.scores import scattered_score, score_count
from soundspaces_sim.transport.bsdf.surface import lambertian_energy
from soundspaces_sim.transport.model import Model
from soundspaces_sim.transport.radiance_transfer.first_reflections import patches_drawn
from soundspaces_sim.transport.radiance_transfer.pair_transfer import (
    Endpoints,
    make_endpoints,
    transfer_one_way,
)
from soundspaces_sim.transport.radiance_transfer.plan import make_transfer_plan
from soundspaces_sim.transport.radiance_transfer.shared_and_own import (
    own_populations,
    shared_populations,
)
from soundspaces_sim.transport.radiance_transfer.transfer_subpaths import (
    Populations,
    face_below,
    set_out,
)
from soundspaces_sim.transport.state import World
from soundspaces_sim.transport.tile import Tile, Walks


class _Starts(NamedTuple):
    """Where the transfer subpaths of the events (E,) set out."""

    patch: np.ndarray  # (E,)
    material: np.ndarray  # (E,) row of `Surfaces`, -1 for none


class _Logs(NamedTuple):
    """Derivatives of ln(energy) by one quantity of one group."""

    first: np.ndarray  # (E, b) of first reflections, those on their patches included
    onward: (
        np.ndarray
    )  # (E, b) of the events of transfer subpaths, that from which they set out included
    strength: np.ndarray  # (C, b) of R


@stage("derivatives of radiance transfer")
def weighted_derivatives(
    tile: Tile, of_a: Walks, of_b: Walks, weight: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """(M, b): sums over pairs and bins of `weight` (A, B, bins, b) times the energy's derivative by ln ρ_m and,
    where surfaces have scores, by the scattering of the table; (0, b) where they have none.

    Of a tile between two sides, to which radiance transfer has been added, and the walks of both."""
    model, plan = tile.model, make_transfer_plan(tile.model)
    groups, scored = plan.material_groups, score_count(model.world.surfaces)
    plan = plan._replace(groups=plan.groups._replace(kept=plan.groups.kept[:0]))
    a, b = of_a.once(make_endpoints), of_b.once(make_endpoints)
    late = 0.5 * weight[:, :, plan.first_bin :] * plan.restore  # either way is half of a pair's energy
    late = np.moveaxis(late, 3, 0)  # (b, A, B, late bins)
    out = np.zeros((groups, plan.bands)), np.zeros((scored, plan.bands))
    starts = [_starts(model, end) for end in (a, b)]
    directions = (a, b, late, starts[0]), (b, a, late.swapaxes(1, 2), starts[1])
    with threadpool_limits(limits=1, user_api="blas"):
        for of, to, of_pairs, start in directions:
            there = transfer_one_way(plan, of, to, drop_rounding=True) > 0.0
            for sums, logs in zip(out, (_by_reflected, _by_scattering), strict=True):
                for m in range(len(sums)):
                    of_m, to_m = logs(model, of, start, m), logs(model, to, None, m)
                    for pair in _multiplied(of, to, start, of_m, to_m):
                        found = transfer_one_way(plan, *pair)
                        sums[m] += np.einsum("bpqt,bpqt->b", of_pairs, np.where(there, found, 0.0))
    return out


def _multiplied(
    of: Endpoints, to: Endpoints, start: _Starts, of_m: _Logs, to_m: _Logs
) -> Iterator[tuple[Endpoints, Endpoints]]:
    """Endpoints whose energies add up to the derivative: events of V times the logarithm's derivatives up to the
    patch on which they are carried on, times those of transfer subpaths, and events of F."""
    first, onward, last = of.reflections, of.subpaths, to.reflections
    yield of._replace(reflections=first._replace(energy=_times(first.energy, of_m.first))), to
    later = _times(onward.energy, of_m.onward - of_m.strength[start.patch])
    alone = first._replace(patch=np.full_like(first.patch, -1))
    yield of._replace(reflections=alone, subpaths=onward._replace(energy=later)), to
    reached = _times(last.energy, to_m.first - to_m.strength[last.patch])
    yield of, to._replace(reflections=last._replace(energy=reached))


def _times(energy: np.ndarray, logs: np.ndarray) -> np.ndarray:
    return np.asarray((energy * logs).astype(np.float32))


def _by_reflected(model: Model, end: Endpoints, start: _Starts | None, m: int) -> _Logs:
    """By ln ρ_m: counts of reflections. Without `start`, none of transfer subpaths."""
    group, bands = model.world.surfaces.group, end.reflections.energy.shape[1]
    own = end.reflections.group == m
    first = np.repeat((end.reflections.counts[:, m] + own)[:, None], bands, axis=1)
    onward = np.empty((0, bands))
    if start is not None:
        left = (start.material >= 0) & (group[start.material] == m)
        onward = np.repeat((end.subpaths.counts[:, m] + left)[:, None], bands, axis=1)
    of_material = np.repeat((group == m)[:, None], bands, axis=1)
    return _Logs(first, onward, _mean_of_patches(model, of_material))


def _by_scattering(model: Model, end: Endpoints, start: _Starts | None, m: int) -> _Logs:
    """By the scattering of group m: scores."""
    surfaces = model.world.surfaces
    of_material = np.where((surfaces.group == m)[:, None], scattered_score(surfaces), 0.0)
    onward = np.empty((0, of_material.shape[1]))
    if start is not None:
        left = np.where((start.material >= 0)[:, None], of_material[start.material], 0.0)
        onward = end.subpaths.scores[:, m] + left
    return _Logs(end.reflections.scores[:, m], onward, _mean_of_patches(model, of_material))


def _starts(model: Model, ends: Endpoints) -> _Starts:
    world, subpaths = model.world, ends.subpaths
    if model.config.radiance_transfer.subpaths == "own":
        populations = own_populations(patches_drawn(ends.reflections, ends.drawn), ends.keys)
    else:
        populations = shared_populations(world, model.seed)
    rows, slots = populations.patch.shape
    materials = np.empty((rows, slots), np.int64)
    over_rows(_find_start_materials, rows, world, populations, materials)
    chunks = (subpaths.start.shape[1] - 1) // slots
    events = np.diff(subpaths.start[:, ::chunks], axis=1).ravel()
    return _Starts(np.repeat(populations.patch.ravel(), events), np.repeat(materials.ravel(), events))


@kernel
def _find_start_materials(
    first: int, last: int, world: World, populations: Populations, out: np.ndarray
) -> None:
    """Fill rows `first` to `last` of `out` (M, S): material from which a subpath sets out, -1 for none."""
    places = world.patches.places
    for row in range(first, last):
        key = combine(populations.key[row], 0)
        for s in range(out.shape[1]):
            c = populations.patch[row, s]
            out[row, s] = -1
            if c >= 0:
                k, _, _, _, point = set_out(places, combine(key, s), c)
                n = row_of(places.normal, k)
                below = face_below(world, lifted(world.geometry, point, n), n)
                if below >= 0:
                    out[row, s] = material_met(world.geometry, below, negate(n))


def _mean_of_patches(model: Model, of_material: np.ndarray) -> np.ndarray:
    """(C, b) means over patches, by strength, of what surfaces have, (m, b)."""
    geometry, surfaces, patches = model.world.geometry, model.world.surfaces, model.world.patches
    places, bins = patches.places, len(patches.weight)
    patch = np.repeat(np.arange(bins), np.diff(places.start))
    behind = (places.normal * geometry.normal[places.triangle]).sum(axis=1) < 0.0
    material = geometry.material[places.triangle, behind.astype(int)]
    strength = (lambertian_energy(surfaces) * of_material)[material] * places.area[:, None]
    sums = [np.bincount(patch, column, bins) for column in strength.T]
    return np.stack(sums, axis=1) * patches.weight
