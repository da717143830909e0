"""What radiance transfer makes of a scene and a model: patches, transfer subpaths, and whether it takes part."""

from __future__ import annotations

import logging
from functools import partial
from typing import Literal

import msgspec
import numpy as np

from soundspaces_sim.core.config import SimulationConfig
from soundspaces_sim.core.io.check_cached import are_starts, like, within
from soundspaces_sim.core.io.disk_cache import cached_on_disk, fingerprint
from soundspaces_sim.core.profile import stage
from soundspaces_sim.scene.scene import scene_key
from soundspaces_sim.transport.bsdf.surface import group_count, lambertian_energy, non_lambertian
from soundspaces_sim.transport.element_depths import air_on_sides
from soundspaces_sim.transport.model import Model, PreparedScene, late_from, time_bins
from soundspaces_sim.transport.radiance_transfer.batch_variance import group_patches
from soundspaces_sim.transport.radiance_transfer.decay_compensation import Decay
from soundspaces_sim.transport.radiance_transfer.patch_construction import make_patches
from soundspaces_sim.transport.radiance_transfer.patch_size import patch_size
from soundspaces_sim.transport.radiance_transfer.patches import Patches
from soundspaces_sim.transport.radiance_transfer.shared_and_own import (
    events_of_pilots,
    own_continuations,
    pilot_decay,
    subpath_count,
    subpaths_per_patch,
    trace_transfer_subpaths,
)
from soundspaces_sim.transport.radiance_transfer.transfer_subpaths import CHUNK, TransferSubpaths
from soundspaces_sim.transport.state import World
from soundspaces_sim.transport.tables import BATCHES
from soundspaces_sim.transport.technique import Facets

_log = logging.getLogger(__name__)
_PATCHES = {
    "dual": "f8 F 2 3",
    "splits": "i8 F",
    "first": "i8 F",
    "of_piece": "i4 n 2",
    "weight": "f8 C b",
    "middle": "f8 C 3",
}
_PLACES = {
    "start": "i8 C1",
    "triangle": "i8 m",
    "area": "f8 m",
    "corners": "f8 m 3 3",
    "normal": "f8 m 3",
    "upto": "f8 m",
    "ratio": "f8 m b",
}
_SUBPATHS = {
    "start": "i8 M s",
    "patch": "i4 e",
    "length": "f4 e",
    "energy": "f4 e b",
    "counts": "u2 e g",
    "decay": "f8 b",
    "reach": "f8 b",
}


def reason_against(prepared: PreparedScene, duration: float) -> str:
    """Why radiance transfer may not make late scattered sound of `duration` s; "" if it may."""
    config = prepared.config
    if not config.radiance_transfer.enabled:
        return "radiance transfer is off"
    edges, _ = time_bins(config, duration)
    if not late_from(config, edges) < edges[-1]:
        return f"there is none after the window of connections ({config.connections.window:g} s)"
    lobe = non_lambertian(prepared.surfaces, prepared.geometry.material)
    return f"lobe '{lobe}' is not Lambertian, which patches need" if lobe else ""


def mark_patches(facets: Facets, prepared: PreparedScene, duration: float) -> Facets:
    """Subpaths leave late paths that are scattered on a patch to radiance transfer."""
    if reason_against(prepared, duration):
        return facets
    return facets._replace(patches=prepared.once(_patches))


def settle(model: Model, points: int) -> SimulationConfig:
    """``auto`` transfer subpaths as ``own`` or ``shared`` ones, whichever is less to trace for a job's points.

    All of them thin out alike with length, so their number tells the cost. Own ones bring no more noise: those of
    two points are independent, and a point has as many as half of its specular subpaths.
    """
    config = model.config
    chosen = config.radiance_transfer
    if chosen.subpaths != "auto":
        return config
    shared = subpath_count(model.world) * len(model.world.patches.weight)
    own = points * BATCHES * own_continuations(model.world)
    kind: Literal["own", "shared"] = "own" if own < shared else "shared"
    _log.info(
        "Transfer subpaths: %s (%d points have %d of their own, patches %d)", kind, points, own, shared
    )
    return msgspec.structs.replace(
        config, radiance_transfer=msgspec.structs.replace(chosen, subpaths=kind)
    )


def describe(model: Model) -> str:
    """Which technique makes late scattered sound, and why: radiance transfer wherever it can
    (notes/laboratory.md compares both)."""
    return f"Late sound that was scattered: {late_technique(model)}"


def late_technique(model: Model) -> str:
    """As `describe`, the technique alone."""
    patches = len(model.world.patches.weight)
    why = reason_against(model.prepared, model.duration)
    if not (why or patches):
        why = "no surface is large enough for a patch, or none scatters"
    if why:
        return f"receiver volumes, as {why}"
    if model.config.radiance_transfer.subpaths == "own":
        number = BATCHES * own_continuations(model.world)
        return f"radiance transfer, with {patches} patches and {number} transfer subpaths of each point's own"
    subpaths = subpaths_per_patch(model.world.settings.round, patches)
    return f"radiance transfer, with {patches} patches and {subpaths} transfer subpaths from each"


@stage("shared transfer subpaths")
def transfer_subpaths(model: Model) -> TransferSubpaths:
    """Subpaths from patch to patch, which all points share: `model.once(transfer_subpaths)`."""
    key = scene_key(model.scene), model.config, model.duration, model.seed
    make = partial(trace_transfer_subpaths, model.world, model.seed)
    return cached_on_disk(TransferSubpaths, key, make, partial(subpaths_fit, world=model.world))


def late_decay(model: Model) -> Decay:
    """By which late energies are compensated: `model.once(late_decay)`."""
    if model.config.radiance_transfer.subpaths == "own":
        return model.first.once(pilot_decay)
    subpaths = model.once(transfer_subpaths)
    return Decay(subpaths.decay, subpaths.reach)


@stage("late decay")
def pilot_events(model: Model) -> float:
    """Events of a transfer subpath, in the mean, as far as pilots tell: `model.first.once(pilot_events)`."""
    return events_of_pilots(model.world, model.seed)


@stage("groups of patches")
def patch_groups(model: Model) -> np.ndarray:
    """(C,) groups of patches, for batch variances: `model.first.once(patch_groups)`."""
    return group_patches(model.world.geometry, model.world.patches)


def _patches(prepared: PreparedScene) -> Patches:
    scene, geometry = prepared.scene, prepared.geometry
    corners = scene.corners - scene.center
    scattered = lambertian_energy(prepared.surfaces)[geometry.material]
    scattered *= air_on_sides(geometry, prepared.surfaces, corners, scene.areas, prepared.thin)[
        :, :, None
    ]
    return cached_on_disk(
        Patches,
        (scene_key(scene), fingerprint(scattered)),
        lambda: make_patches(geometry, corners, scattered, patch_size(geometry, corners, scene.areas)),
        lambda found: patches_fit(found, len(scattered), scattered.shape[2]),
    )


def patches_fit(patches: Patches, faces: int, bands: int) -> bool:
    """What `patches.make_patches` makes of so many faces."""
    sizes = {"F": faces, "b": bands}
    places = patches.places
    flat = patches._replace(places=None)  # type: ignore[arg-type]
    if not like(flat, _PATCHES, sizes):
        return False
    count = sizes["C"]
    sizes["C1"] = count + 1
    if not like(places, _PLACES, sizes):
        return False
    splits, first = patches.splits, patches.first
    if not (within(splits, 1, 2**15) and within(first, 0, sizes["n"])):
        return False
    last = first + np.where(splits > 1, 2 * splits**2, 1)
    return bool(
        (last <= sizes["n"]).all()
        and _are_pieces(patches.of_piece, count)
        and within(places.triangle, 0, faces - 1)
        and (patches.weight >= 0.0).all()
        and are_starts(places.start, sizes["m"])
        and (places.start[:-1] < sizes["m"]).all()
    )


def _are_pieces(of_piece: np.ndarray, patches: int) -> bool:
    """Whether these are patches, or quarters that come after their piece."""
    number, quarters = np.arange(len(of_piece)), -2 - of_piece[:, 0].astype(np.int64)
    split = (of_piece < -1).any(axis=1)
    last = quarters + 3 < len(of_piece)
    good = (of_piece[:, 0] == of_piece[:, 1]) & (quarters > number) & last
    return within(of_piece[~split], -1, patches - 1) and bool(good[split].all())


def subpaths_fit(subpaths: TransferSubpaths, world: World) -> bool:
    """What `transfer_subpaths.trace_transfer_subpaths` makes."""
    rows, patches, bands = subpath_count(world), len(world.patches.weight), world.air.shape[1]
    chunks = -(-patches // CHUNK)
    sizes = {"M": rows, "s": patches * chunks + 1, "b": bands, "g": group_count(world.surfaces)}
    if not like(subpaths, _SUBPATHS, sizes) or not within(subpaths.patch, 0, patches - 1):
        return False
    start = subpaths.start
    starts = np.append(start[:, :-1].ravel(), start[-1:, -1])
    if not (are_starts(starts, sizes["e"]) and (start[:-1, -1] == start[1:, 0]).all()):
        return False
    chunk = np.repeat(np.tile(np.arange(chunks, dtype=np.int32), rows * patches), np.diff(starts))
    return bool(
        (subpaths.patch // CHUNK == chunk).all()
        and (subpaths.length >= 0.0).all()
        and (subpaths.energy >= 0.0).all()
    )
