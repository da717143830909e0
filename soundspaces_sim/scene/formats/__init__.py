"""Scene formats: a new one is a file here and a line in the table.

Each file has a `FORMAT`, or two, whose `read` gives a mesh in the file's own frame, with what the file says of axis
and unit; `scene.frame` turns it into the scene's frame.
"""

from __future__ import annotations

from collections.abc import Mapping

from soundspaces_sim.scene.formats import (
    catt,
    dae,
    gibson,
    gmsh,
    hm3d,
    ifc,
    isimpa,
    matterport,
    mesh,
    obj,
    odeon,
    replica,
)
from soundspaces_sim.scene.generate import demo
from soundspaces_sim.scene.generate.buildings import registry
from soundspaces_sim.scene.labelled import SceneFormat

#: By name, in the order in which they are tried.
FORMATS: Mapping[str, SceneFormat] = {
    "demo": demo.FORMAT,
    "building": registry.FORMAT,
    "replica": replica.FORMAT,
    "matterport": matterport.FORMAT,
    "hm3d": hm3d.FORMAT,
    "gibson": gibson.FORMAT,
    "ifc": ifc.FORMAT,
    "dae": dae.FORMAT,
    "isimpa": isimpa.FORMAT,
    "isimpa-project": isimpa.PROJECT,
    "gmsh": gmsh.FORMAT,  # before catt, whose files have the same suffix
    "catt": catt.FORMAT,
    "odeon": odeon.FORMAT,
    "obj": obj.FORMAT,
    "mesh": mesh.FORMAT,
}


def find_format(source: str) -> SceneFormat | None:
    """The first format that detects a name or path, or None."""
    return next((f for f in FORMATS.values() if f.detects(source)), None)


def accepted() -> str:
    """What can be read, for messages and help."""
    return "; ".join(f.accepts for f in FORMATS.values())
