"""The ways of making a path, one file each, and the table of which path is whose.

A technique has up to two doors. `trace(tile, own, other, rows, tables)` sends out the walks of some
points of a side and deposits them at the points of the other; what they leave for later stays on the side.
`close(tile)` adds to the tile what is made pair by pair. Every path is made by exactly one technique or by
several whose weights sum to one (`mis`, docs/theory.md).

A new technique is a file and its row here.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from soundspaces_sim.transport.diffraction import double as double_edges
from soundspaces_sim.transport.diffraction import finite_reflectors as rims
from soundspaces_sim.transport.diffraction import mixed as mirror_edges
from soundspaces_sim.transport.diffraction import single as edges
from soundspaces_sim.transport.image_source import image_source as images
from soundspaces_sim.transport.paths import connections as connect
from soundspaces_sim.transport.paths import direct, specular
from soundspaces_sim.transport.paths import receiver_volumes as hits
from soundspaces_sim.transport.radiance_transfer import transfer as middle
from soundspaces_sim.transport.state import Tables
from soundspaces_sim.transport.tile import Side, Tile

Trace = Callable[[Tile, Side, Side, slice, Tables], None]
Close = Callable[[Tile], None]


@dataclass(frozen=True)
class Technique:
    """`paths`: those it makes, for people. `deposits`: it adds to a tile's tables, not to its discrete paths."""

    name: str
    paths: str
    trace: Trace | None = None
    close: Close | None = None
    deposits: bool = False


TECHNIQUES = (
    Technique("direct", "the straight one, through walls that let sound pass", close=direct.close),
    Technique("edges", "round one edge, out of sight; and the direct one past edges", close=edges.close),
    Technique("double_edges", "round two edges, out of sight", close=double_edges.close),
    Technique("images", "one or two mirrors, all at grouped planes", close=images.close),
    Technique(
        "rims", "mirror ones where the mirror ends, and beside it by way of its edge", close=rims.close
    ),
    Technique(
        "mirror_edges",
        "one mirror and one edge, in either order; and mirror ones past edges",
        close=mirror_edges.close,
    ),
    Technique(
        "specular",
        "all others that are never scattered; with patches also late ones that none scatters",
        trace=specular.trace,
        deposits=True,
    ),
    Technique(
        "hits",
        "scattered; shares early ones with connect; none that are late, with patches",
        trace=hits.trace,
        deposits=True,
    ),
    Technique(
        "connect",
        "scattered, up to the join window; shares them with hits",
        close=connect.close,
        deposits=True,
    ),
    Technique("middle", "late ones that are scattered on a patch", close=middle.close, deposits=True),
)
