"""Wavefront OBJ: the names after `usemtl` are labels, whether the .mtl file is there or not.

A file without `usemtl` is labelled by its groups (`g`) and objects (`o`). Textures are not looked at. The format
has no unit, but SketchUp and others write one into a comment (``# File units = feet``), which is believed.
"""

from __future__ import annotations

import io
import re
from pathlib import Path

from soundspaces_sim.scene.adopt import is_made_up
from soundspaces_sim.scene.formats.limits import open_mesh
from soundspaces_sim.scene.formats.mesh import from_parts, open_with_trimesh, with_unit
from soundspaces_sim.scene.labelled import LabelledMesh, SceneFormat

# To the end of the line, blanks and all: a pattern that leaves them out takes quadratic time on many of them.
_NAME = re.compile(r"^[ \t]*usemtl[ \t]+(.*)$", re.MULTILINE)
_GROUP = re.compile(r"^[ \t]*[go][ \t]+(.*)$", re.MULTILINE)
_LIBRARY = re.compile(r"^[ \t]*mtllib\b.*$", re.MULTILINE)
_UNIT = re.compile(
    r"^#(?:[ \t]*file)?[ \t]*units?[ \t]*[=:]?[ \t]*([a-z]+)[ \t]*$", re.MULTILINE | re.IGNORECASE
)
_HEAD = 2**16  # characters in which a unit is looked for


class _Names:
    """Stands for the .mtl file: a material of every name that is used."""

    def __init__(self, names: set[str]) -> None:
        self._text = "".join(f"newmtl {name}\nKd 1 1 1\n" for name in sorted(names)).encode()

    def __getitem__(self, _: str) -> bytes:
        return self._text

    get = __getitem__


def read_obj(source: str) -> LabelledMesh:
    """Read an OBJ file. Raises `SceneError`."""
    path = Path(source)
    with open_mesh(path) as file:
        text = file.read().decode("utf-8", "replace")
    text = text.replace("\r\n", "\n").replace("\r", "\n").replace("\\\n", "")
    if not _NAME.search(text) and not all(map(is_made_up, _names(_GROUP, text))):
        text = _GROUP.sub(_used, text)
    text = _NAME.sub(_used, text)
    names = {name for name in _names(_NAME, text) if name}
    text = "mtllib names.mtl\n" + _LIBRARY.sub("", text)
    unit = _UNIT.search(text[:_HEAD])
    scene = open_with_trimesh(path, io.BytesIO(text.encode()), "obj", _Names(names))
    mesh = from_parts(path, scene)
    return mesh if unit is None else with_unit(mesh, unit.group(1))


def _names(pattern: re.Pattern[str], text: str) -> list[str]:
    return [name.strip() for name in pattern.findall(text)]


def _used(found: re.Match[str]) -> str:
    return f"usemtl {found.group(1).strip()}"


FORMAT = SceneFormat(
    "an OBJ file",
    lambda source: Path(source).suffix.lower() == ".obj" and Path(source).is_file(),
    read_obj,
    beside=True,
)
