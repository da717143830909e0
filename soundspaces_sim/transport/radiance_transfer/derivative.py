"""Derivatives of radiance transfer's energies by what materials reflect, for the very subpaths.

Energies are bilinear, E = ⟨V, F⟩ (the package's docstring), and an event that group m has reflected n times carries
ρ_m^n. So with V^m and F^m the histograms of the same events, each times its count,

    dE / d ln ρ_m = ⟨V^m, F⟩ + ⟨V, F^m⟩.

V counts the reflection on the patch. F has the patch's ρs as well, over R, the integral of ρs over the patch: of
these the group's part of R is taken off, so that a reflection on a patch of one material counts once. So it is with
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
from soundspaces_sim.core.numerics.vec3 import row as row_of
from soundspaces_sim.core.profile import stage
from soundspaces_sim.scene.rays.geometry import lifted
from soundspaces_sim.transport.bsdf.surface import lambertian_energy
from soundspaces_sim.transport.model import Model
from soundspaces_sim.transport.radiance_transfer.first_reflections import patches_drawn
from soundspaces_sim.transport.radiance_transfer.pair_transfer import Endpoints, make_endpoints, transfer
from soundspaces_sim.transport.radiance_transfer.patches import Patches
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
from soundspaces_sim.transport.tile import Tile


class _Starts(NamedTuple):
    """Where the transfer subpaths of the events (E,) set out."""

    patch: np.ndarray  # (E,)
    group: np.ndarray  # (E,) of the material, -1 for none


@stage("derivatives of radiance transfer")
def weighted_derivatives(tile: Tile, weight: np.ndarray) -> np.ndarray:
    """(M, b): sum over pairs and bins of `weight` (A, B, bins, b) times the energy's derivative by ln ρ_m.

    Of a tile between two sides, to which radiance transfer has been added."""
    plan = make_transfer_plan(tile.model)
    groups = plan.material_groups
    plan = plan._replace(groups=plan.groups._replace(kept=plan.groups.kept[:0]))
    a, b = tile.a.once(make_endpoints), tile.b.once(make_endpoints)
    late = 0.5 * weight[:, :, plan.first_bin :] * plan.restore  # either way is half of a pair's energy
    late = np.moveaxis(late, 3, 0)  # (b, A, B, late bins)
    out = np.zeros((groups, plan.bands))
    shares, starts = _shares_of_groups(tile.model, groups), [_starts(tile.model, end) for end in (a, b)]
    with threadpool_limits(limits=1, user_api="blas"):
        for of, to, of_pairs, start in zip(
            (a, b), (b, a), (late, late.swapaxes(1, 2)), starts, strict=True
        ):
            there = transfer(plan, of, to).energy > 0.0
            for m in range(groups):
                for of_m, to_m in _counted(of, to, m, shares[m], start):
                    found = transfer(plan, of_m, to_m, drop_rounding=False).energy
                    out[m] += np.einsum("bpqt,bpqt->b", of_pairs, np.where(there, found, 0.0))
    return out


def _counted(
    of: Endpoints, to: Endpoints, m: int, share: np.ndarray, start: _Starts
) -> Iterator[tuple[Endpoints, Endpoints]]:
    """Endpoints whose energies add up to the derivative: events of V by their reflections up to the patch on which
    they are carried on, by those of transfer subpaths, and events of F. `share` (C, b) of a patch's strength."""
    first, onward = of.reflections, of.subpaths
    own = (first.group == m).astype(np.float32)
    reached = (first.counts[:, m] + own)[:, None] * first.energy
    yield of._replace(reflections=first._replace(energy=reached.astype(np.float32))), to
    left = (start.group == m)[:, None] - share[start.patch]
    later = onward._replace(
        energy=(onward.energy * (onward.counts[:, m, None] + left)).astype(np.float32)
    )
    alone = first._replace(patch=np.full_like(first.patch, -1))
    yield of._replace(reflections=alone, subpaths=later), to
    last = to.reflections
    counted = last.counts[:, m, None] + (last.group == m)[:, None] - share[last.patch]
    yield of, to._replace(reflections=last._replace(energy=(counted * last.energy).astype(np.float32)))


def _starts(model: Model, ends: Endpoints) -> _Starts:
    world, subpaths = model.world, ends.subpaths
    if model.config.radiance_transfer.subpaths == "own":
        populations = own_populations(patches_drawn(ends.reflections, ends.drawn), ends.keys)
    else:
        populations = shared_populations(world, model.seed)
    rows, slots = populations.patch.shape
    groups = np.empty((rows, slots), np.int64)
    over_rows(_find_start_groups, rows, world, populations, groups)
    chunks = (subpaths.start.shape[1] - 1) // slots
    events = np.diff(subpaths.start[:, ::chunks], axis=1).ravel()
    return _Starts(np.repeat(populations.patch.ravel(), events), np.repeat(groups.ravel(), events))


@kernel
def _find_start_groups(
    first: int, last: int, world: World, populations: Populations, out: np.ndarray
) -> None:
    """Fill rows `first` to `last` of `out` (M, S): group of the material from which a subpath sets out, -1 for
    none."""
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
                    out[row, s] = world.surfaces.group[world.geometry.material[below]]


def _shares_of_groups(model: Model, groups: int) -> np.ndarray:
    """(M, C, b) share of a group's materials in R, the strength of each patch."""
    geometry, surfaces, patches = model.world.geometry, model.world.surfaces, model.world.patches
    corners = model.scene.corners
    along = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    area = 0.5 * np.linalg.norm(np.cross(*along), axis=1)
    strength = lambertian_energy(surfaces)[geometry.material] * area[:, None]
    triangle, patch = _pieces(patches)
    of_piece = strength[triangle] / patches.splits[triangle, None] ** 2
    group = surfaces.group[geometry.material][triangle]
    return np.stack([_summed(of_piece * (group == m)[:, None], patch, patches) for m in range(groups)])


def _pieces(patches: Patches) -> tuple[np.ndarray, np.ndarray]:
    """Triangle and patch of every side of a piece that has one."""
    ends = np.append(patches.first[1:], len(patches.of_piece))
    triangle = np.repeat(np.arange(len(patches.first)), ends - patches.first)
    piece, side = np.nonzero(patches.of_piece >= 0)
    return triangle[piece], patches.of_piece[piece, side]


def _summed(strength: np.ndarray, patch: np.ndarray, patches: Patches) -> np.ndarray:
    """(C, b) sums over the pieces of patches, times 1 / R."""
    sums = [np.bincount(patch, column, len(patches.weight)) for column in strength.T]
    return np.stack(sums, axis=1) * patches.weight
