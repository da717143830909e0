"""Acoustic radiance transfer as a technique."""

from soundspaces_sim.transport.radiance_transfer.prepared import describe, mark_patches, settle
from soundspaces_sim.transport.radiance_transfer.transfer import connect
from soundspaces_sim.transport.technique import Technique

RADIANCE_TRANSFER = Technique(
    "radiance_transfer",
    "late ones that are scattered on a patch",
    mark=mark_patches,
    connect=connect,
    requires=("specular",),
    deposits=True,
    settle=settle,
    describe=describe,
)
