"""Subpaths as techniques."""

from soundspaces_sim.transport.paths import connections, specular, subpath
from soundspaces_sim.transport.technique import Technique

SPECULAR = Technique(
    "specular",
    "all others that are never scattered; with patches also late ones that none scatters",
    trace=specular.trace,
)
RECEIVER_VOLUMES = Technique(
    "receiver_volumes",
    "scattered; shares early ones with connections; none that are late, with patches",
    trace=subpath.trace,
)
CONNECTIONS = Technique(
    "connections",
    "scattered, up to the connection window; shares them with receiver volumes",
    join=connections.join,
    requires=("receiver_volumes",),
)
