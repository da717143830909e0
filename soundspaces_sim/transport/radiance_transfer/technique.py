"""Acoustic radiance transfer as a technique."""

from soundspaces_sim.transport.radiance_transfer.prepared import describe, mark_patches, settle
from soundspaces_sim.transport.radiance_transfer.transfer import join
from soundspaces_sim.transport.technique import Technique

RADIANCE_TRANSFER = Technique(
    "radiance_transfer",
    "late ones that are scattered on a patch",
    mark=mark_patches,
    join=join,
    requires=("specular",),
    settle=settle,
    describe=describe,
)
