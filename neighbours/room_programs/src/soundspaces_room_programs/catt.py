"""CATT-Acoustic's .geo: corners, planes and absorption by octaves, as numbers. Z up, metres.

The format is a small language. What is read are its results: `CORNERS` (number x y z), `PLANES` ([number name /
corners / material]) and `ABS` (percent in octaves from 125 Hz on, with scattering after `L`); comments begin
with a semicolon. A file with commands in it (constants, `INCLUDE`, `MIRROR`, loops, subdivided planes) is
refused with its line: save it from TUCT, which writes it out in numbers. Nothing else is opened.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

from soundspaces_room_programs.gmsh import is_gmsh
from soundspaces_room_programs.polygon_mesh import Polygon, mesh_of_polygons, read_text_model
from soundspaces_room_programs.polygons import MOST_CORNERS
from soundspaces_sim import MaterialTable, SceneError
from soundspaces_sim.parts import (
    MATERIAL_OCTAVES as OCTAVES,
    MATERIAL_SCATTERING as SCATTERING,
    LabelledMesh,
    SceneFormat,
    octave_material,
    open_mesh,
)

_MOST_MATERIALS, _LONGEST = 1000, 10_000  # characters of a plane
_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
_CORNER = re.compile(rf"(\d{{1,9}})\s+({_NUMBER})\s+({_NUMBER})\s+({_NUMBER})")
_PLANE = re.compile(r"\s*(-?\d{1,9})\s+([^/\\]*)[/\\]([^/\\]*)[/\\]([^/\\]*)")
_ABS = re.compile(
    r"ABS\s+([^=<]{1,100}?)\s*=?\s*<([^<>]*)>\s*(?:L\s*<([^<>]*)>)?\s*(?:\{[^{}]*\})?", re.IGNORECASE
)
_HELP = "only numbers are read here: save the model from TUCT, which writes them out"


def read_catt(source: str) -> LabelledMesh:
    """Read a model; each face's label is the name of its plane's material. Raises `SceneError`."""
    path = Path(source)
    with open_mesh(path) as file:
        content = file.read()
    points: dict[int, tuple[float, float, float]] = {}
    planes: list[tuple[int, str]] = []
    materials: dict[str, MaterialTable] = {}
    unscattered: list[str] = []
    section = ""
    for number, line in enumerate(read_text_model(path, content).split("\n"), 1):
        text = " ".join(line.partition(";")[0].split())
        word = text.upper()
        if word in ("CORNERS", "PLANES"):
            section = word
        elif word.startswith("ABS") and section != "PLANES":
            if len(materials) == _MOST_MATERIALS:
                raise SceneError(f"{path}: line {number}: more than {_MOST_MATERIALS} materials")
            name, table, scattered = _material(f"{path}: line {number}", path.name, text)
            materials[name] = table
            unscattered += [] if scattered else [name]
        elif text and section == "PLANES":
            planes.append((number, text))
        elif text:
            found = _CORNER.fullmatch(text) if section == "CORNERS" else None
            if found is None:
                raise SceneError(f"{path}: line {number}: {text[:60]!r} is not understood; {_HELP}")
            x, y, z = (float(v) for v in found.groups()[1:])
            points[int(found.group(1))] = x, y, z
    notes = (
        (f"no scattering is given for {', '.join(unscattered[:8])}: {SCATTERING:g}",)
        if unscattered
        else ()
    )
    return mesh_of_polygons(path, len(content), points, _polygons(path, planes), 1.0, materials, notes)


def _polygons(path: Path, lines: list[tuple[int, str]]) -> Iterator[Polygon]:
    """Planes, which may go over several lines; one by one, as few characters may name many corners."""
    begun, first = "", 0
    for number, line in lines:
        text, first, at = (f"{begun} {line}", first, 0) if begun else (line, number, 0)
        begun = ""
        while at < len(text):
            if text[at] == " ":
                at += 1
                continue
            end = text.find("]", at)
            if text[at] != "[":
                found = text[at : at + 60]
                raise SceneError(f"{path}: line {first}: {found!r} is not understood; {_HELP}")
            if end < 0:
                begun = text[at:]
                break
            yield _polygon(path, f"line {first}", text[at + 1 : end])
            at, first = end + 1, number
        if len(begun) > _LONGEST:
            break
    if begun:
        raise SceneError(f"{path}: line {first}: a plane does not end")


def _polygon(path: Path, where: str, text: str) -> Polygon:
    found = _PLANE.fullmatch(text)
    if found is None or "(" in text:
        raise SceneError(
            f"{path}: {where}: expected [number name / corners / material], got {text[:60]!r}; {_HELP}"
        )
    corners: list[int] = []
    for part in re.split(r"[\s,]+", found.group(3).strip()):
        ends = re.fullmatch(r"(\d{1,9})(?:-(\d{1,9}))?", part)
        if ends is None:
            raise SceneError(f"{path}: {where}: expected numbers of corners, got {part[:60]!r}; {_HELP}")
        low, high = int(ends.group(1)), int(ends.group(2) or ends.group(1))
        if len(corners) + abs(high - low) >= MOST_CORNERS:
            raise SceneError(f"{path}: {where}: expected at most {MOST_CORNERS} corners, got {part}")
        corners += range(low, high + 1) if high >= low else range(low, high - 1, -1)
    return Polygon(
        f"{where}, plane {found.group(1)}", corners, found.group(4).strip().rstrip("*").strip()
    )


def _material(where: str, file: str, text: str) -> tuple[str, MaterialTable, bool]:
    """Name and coefficients of a material, and whether its scattering is given."""
    found = _ABS.fullmatch(text)
    if found is None:
        raise SceneError(
            f"{where}: expected ABS name = <percent …> L <percent …>, got {text[:60]!r}; {_HELP}"
        )
    name = found.group(1).strip()
    scattered = None if found.group(3) is None else _percent(where, found.group(3))
    table = octave_material(where, f"{name} of {file}", _percent(where, found.group(2)), scattered)
    return name, table, scattered is not None


def _percent(where: str, text: str) -> list[float]:
    """Shares of 1 to 8 octaves; a colon may stand before those above 4 kHz."""
    words = text.replace(":", " ").split()
    if not 1 <= len(words) <= len(OCTAVES) or not all(re.fullmatch(_NUMBER, w) for w in words):
        raise SceneError(
            f"{where}: expected percent in 1 to {len(OCTAVES)} octaves, got <{text[:60]}>; {_HELP}"
        )
    return [float(w) / 100.0 for w in words]


FORMAT = SceneFormat(
    "a .geo file of CATT-Acoustic",
    lambda source: (
        Path(source).suffix.lower() == ".geo" and Path(source).is_file() and not is_gmsh(source)
    ),
    read_catt,
)
