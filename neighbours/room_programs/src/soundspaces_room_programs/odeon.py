"""ODEON's .par: points and surfaces as numbers. Z up; metres unless `Unit` says otherwise.

The format is a small language as well. What is read are `Unit`, `Pt` (number x y z), `Surf` (number and name,
then a line of corners), `NumbOffSet` with a number, and `BeginBlock`, `EndBlock`; what follows a colon is a
comment, and so is what stands outside two lines of ###. A surface with a negative number has a twin mirrored at
y = 0 (ODEON 11, User manual, 2011, statements of surfaces). That a negative corner is the one mirrored at y = 0 was
found in no document: a model that has such corners gets a note. Other statements (`Const`, `For`, `Box`, …) are
refused with their line: import the model into ODEON's editor and save it as surfaces. Absorption is in another file
of ODEON's, by the surfaces' numbers: labels are the surfaces' names.
"""

from __future__ import annotations

import re
from pathlib import Path

from soundspaces_room_programs.polygon_mesh import Polygon, mesh_of_polygons, read_text_model
from soundspaces_sim import SceneError
from soundspaces_sim.parts import LabelledMesh, SceneFormat, open_mesh

_UNITS = {
    "metres": 1.0, "meters": 1.0, "m": 1.0, "centimetres": 0.01, "centimeters": 0.01, "cm": 0.01,
    "millimetres": 0.001, "millimeters": 0.001, "mm": 0.001, "inches": 0.0254, "feet": 0.3048, "yards": 0.9144,
}  # fmt: skip
_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
_POINT = re.compile(rf"(\d{{1,9}})\s+({_NUMBER})\s+({_NUMBER})\s+({_NUMBER})")
_SURFACE = re.compile(r"(-?\d{1,9})\s*(.*)")
_MIRRORED = "corners with negative numbers are taken as mirrored at y = 0; compare with ODEON's own view"
_HELP = "only points and surfaces in numbers are read here"


def read_odeon(source: str) -> LabelledMesh:
    """Read a model; each face's label is the name of its surface. Raises `SceneError`."""
    path = Path(source)
    with open_mesh(path) as file:
        content = file.read()
    model = _Model(path)
    lines = read_text_model(path, content).split("\n")
    marks = [i for i, line in enumerate(lines) if line.strip().startswith("###")]
    first, last = (marks[0] + 1, marks[1]) if len(marks) > 1 else (0, len(lines))
    for number in range(first, last):
        model.take(number + 1, " ".join(lines[number].partition(":")[0].split()))
    if model.open is not None:
        raise SceneError(f"{path}: line {last}: a surface has no corners")
    return mesh_of_polygons(
        path, len(content), model.points, model.surfaces, model.metre, notes=model.notes
    )


class _Model:
    """Points, surfaces and unit so far; a corner -n is point n mirrored at y = 0."""

    def __init__(self, path: Path) -> None:
        self.path, self.metre, self.offset = path, 1.0, 0
        self.points: dict[int, tuple[float, float, float]] = {}
        self.surfaces: list[Polygon] = []
        self.open: tuple[int, str] | None = None  # a surface whose corners are to come
        self.notes: tuple[str, ...] = ()

    def take(self, number: int, text: str) -> None:
        """One line without its comment. Raises `SceneError`."""
        if not text:
            return
        if self.open is not None:
            self._corners(number, text)
            return
        word, _, rest = text.partition(" ")
        word = word.lower()
        point, surface = _POINT.fullmatch(rest), _SURFACE.fullmatch(rest)
        if word == "pt" and point is not None:
            x, y, z = (float(v) for v in point.groups()[1:])
            at = int(point.group(1)) + self.offset
            self.points[-at] = x, -y, z
            self.points[at] = x, y, z
        elif word == "surf" and surface is not None:
            self.open = int(surface.group(1)), surface.group(2).strip()
        elif word == "unit" and rest.lower() in _UNITS:
            self.metre = _UNITS[rest.lower()]
        elif word == "numboffset" and re.fullmatch(r"\d{1,9}", rest):
            self.offset = int(rest)
        elif word not in ("beginblock", "endblock"):
            raise SceneError(f"{self.path}: line {number}: {text[:60]!r} is not understood; {_HELP}")

    def _corners(self, number: int, text: str) -> None:
        assert self.open is not None
        words = text.replace(",", " ").split()
        if not all(re.fullmatch(r"-?\d{1,9}", w) for w in words):
            raise SceneError(
                f"{self.path}: line {number}: expected numbers of corners, got {text[:60]!r}; {_HELP}"
            )
        of, name = self.open
        if not self.notes and any(w.startswith("-") for w in words):
            self.notes = (_MIRRORED,)
        corners = [int(w) + (self.offset if int(w) > 0 else -self.offset) for w in words]
        where = f"line {number}, surface {of}"
        self.surfaces.append(Polygon(where, corners, name))
        if of < 0:
            self.surfaces.append(Polygon(f"{where}, mirrored", [-c for c in corners[::-1]], name))
        self.open = None


FORMAT = SceneFormat(
    "a .par file of ODEON",
    lambda source: Path(source).suffix.lower() == ".par" and Path(source).is_file(),
    read_odeon,
)
