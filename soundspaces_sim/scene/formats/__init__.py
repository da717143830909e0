"""Scene formats: a new one is a file here and a line in the table, or an entry point of a distribution of its own.

Each file has a `FORMAT`, or two, whose `read` gives a mesh in the file's own frame, with what the file says of axis
and unit; `scene.frame` turns it into the scene's frame.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache

from soundspaces_sim.core.registry import installed
from soundspaces_sim.scene.formats import elsewhere, matterport, mesh, obj, replica
from soundspaces_sim.scene.generate import demo
from soundspaces_sim.scene.labelled import SceneFormat

GROUP = "soundspaces_sim.scene_formats"  # of entry points; each is a `SceneFormat`
#: By name, in the order in which they are tried.
FORMATS: Mapping[str, SceneFormat] = {
    "demo": demo.FORMAT,
    "replica": replica.FORMAT,
    "matterport": matterport.FORMAT,
    "elsewhere": elsewhere.FORMAT,
    "obj": obj.FORMAT,
    "mesh": mesh.FORMAT,
}


@cache
def neighbours() -> tuple[SceneFormat, ...]:
    """Formats of distributions of their own, which are tried before the table's."""
    return tuple(installed(GROUP, SceneFormat))


def find_format(source: str) -> SceneFormat | None:
    """The first format that detects a name or path, or None."""
    return next((f for f in (*neighbours(), *FORMATS.values()) if f.detects(source)), None)


def accepted() -> str:
    """What can be read, for messages and help."""
    return "; ".join(f.accepts for f in (*FORMATS.values(), *neighbours()))
