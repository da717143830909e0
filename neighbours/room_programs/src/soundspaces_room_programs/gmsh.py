"""Gmsh's .geo, as CHORAS and its pre-processors write rooms: points, lines, loops, plane and physical surfaces.

The format is a language. What is read are `Point`, `Line`, `Line Loop` or `Curve Loop`, `Plane Surface` and
`Physical Surface` in numbers; a physical surface's name is the label of its faces. Volumes, other physical groups
and settings of the mesher say nothing about walls and are passed over; all else is refused with its line. A .geo
file says nothing of unit and axis: they are metres and Z up, as in CHORAS.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

from soundspaces_room_programs.polygon_mesh import Polygon, mesh_of_polygons, read_text_model
from soundspaces_sim import SceneError
from soundspaces_sim.parts import LabelledMesh, SceneFormat, open_mesh

_HEAD = 65_536  # bytes in which a model shows that it is Gmsh's
_OWN = re.compile(rb"^[ \t]*Point[ \t]*\(", re.MULTILINE)
_COMMENT = re.compile(
    r'"[^"\n]*"|//[^\n]*|/\*.*?(?:\*/|\Z)', re.DOTALL
)  # and names, which may look like one
_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
_STATEMENT = re.compile(r"(Physical Surface|[A-Za-z]+(?: [A-Za-z]+)?)\s*\(([^()]*)\)\s*=\s*\{([^{}]*)\}")
_NAME = re.compile(r'\s*(?:"([^"]*)"\s*(?:,\s*\d+\s*)?|(\d+)\s*)')
_PASSED_OVER = re.compile(
    r"(?:Surface Loop|Volume|Physical (?:Volume|Line|Curve|Point)|Mesh|General|Geometry|SetFactory|Coherence"
    r"|Recombine|Characteristic Length|MeshSize)\b.*",
    re.DOTALL,
)
_HELP = "only points, lines, loops, plane and physical surfaces in numbers are read here"


def read_gmsh(source: str) -> LabelledMesh:
    """Read a model; each face's label is the name of its physical surface. Raises `SceneError`."""
    path = Path(source)
    with open_mesh(path) as file:
        content = file.read()
    model = _Model(path)

    def blank(found: re.Match[str]) -> str:
        text = found.group()
        if text.startswith("/*") and not (len(text) > 3 and text.endswith("*/")):
            line = found.string.count("\n", 0, found.start()) + 1
            raise SceneError(f"{path}: line {line}: this comment does not end")
        return text if text.startswith('"') else "\n" * text.count("\n")

    text = _COMMENT.sub(blank, read_text_model(path, content))
    line = 1
    *statements, rest = text.split(";")
    for statement in statements:
        begun = line + statement[: len(statement) - len(statement.lstrip())].count("\n")
        model.take(f"{path}: line {begun}", " ".join(statement.split()))
        line += statement.count("\n")
    if rest.strip():
        raise SceneError(f"{path}: line {line}: {rest.strip()[:60]!r} does not end with a semicolon")
    return mesh_of_polygons(path, len(content), model.points, model.polygons(), 1.0)


class _Model:
    """What statements have defined so far, by number."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.points: dict[int, tuple[float, float, float]] = {}
        self.lines: dict[int, tuple[int, int]] = {}
        self.loops: dict[int, list[int]] = {}
        self.surfaces: dict[int, tuple[str, int]] = {}  # where it stands, and its loop
        self.names: dict[int, str] = {}

    def take(self, where: str, text: str) -> None:
        """One statement. Raises `SceneError`."""
        found = _STATEMENT.fullmatch(text)
        kind = found.group(1) if found else ""
        if not text or (_PASSED_OVER.fullmatch(text) and kind != "Physical Surface"):
            return
        if found is None or kind not in _KINDS:
            raise SceneError(f"{where}: {text[:60]!r} is not understood; {_HELP}")
        values = [word.strip() for word in found.group(3).split(",")]
        if kind == "Physical Surface":
            name = _NAME.fullmatch(found.group(2))
            if name is None:
                raise SceneError(f"{where}: expected a name or a number, got {found.group(2)[:60]!r}")
            label = (name.group(1) if name.group(2) is None else f"surface {name.group(2)}").strip()
            self.names |= {abs(n): label for n in _whole(where, values)}
            return
        (number,) = _whole(where, [found.group(2).strip()])
        if kind == "Point":
            if len(values) not in (3, 4) or not all(re.fullmatch(_NUMBER, v) for v in values):
                raise SceneError(f"{where}: expected x, y and z of a point, got {text[:60]!r}; {_HELP}")
            x, y, z = (float(v) for v in values[:3])
            self.points[number] = x, y, z
            return
        numbers = _whole(where, values)
        if kind == "Line":
            if len(numbers) != 2:
                raise SceneError(f"{where}: expected two points of a line, got {len(numbers)}")
            self.lines[number] = numbers[0], numbers[1]
        elif kind == "Plane Surface":
            if len(numbers) != 1:
                raise SceneError(f"{where}: a surface with holes cannot be read here; cut it into parts")
            self.surfaces[number] = where.removeprefix(f"{self.path}: "), abs(numbers[0])
        else:
            self.loops[number] = numbers

    def polygons(self) -> Iterator[Polygon]:
        """The surfaces as polygons, one by one: many may share a loop. Raises `SceneError`."""
        lost = next((n for n in self.names if n not in self.surfaces), None)
        if lost is not None:
            raise SceneError(
                f"{self.path}: physical surface {self.names[lost]!r}: there is no surface {lost}"
            )
        for n, (where, loop) in self.surfaces.items():
            yield Polygon(f"{where}, surface {n}", self._corners(where, loop), self.names.get(n, ""))

    def _corners(self, where: str, loop: int) -> list[int]:
        if loop not in self.loops:
            raise SceneError(f"{self.path}: {where}: there is no loop {loop}")
        ends = []
        for n in self.loops[loop]:
            if abs(n) not in self.lines:
                raise SceneError(f"{self.path}: {where}: there is no line {abs(n)}")
            ends.append(self.lines[n] if n > 0 else self.lines[-n][::-1])
        if any(end != begin for (_, end), (begin, _) in zip(ends, [*ends[1:], ends[0]], strict=True)):
            raise SceneError(f"{self.path}: {where}: the lines of loop {loop} do not meet end to end")
        return [begin for begin, _ in ends]


_KINDS = ("Point", "Line", "Line Loop", "Curve Loop", "Plane Surface", "Physical Surface")


def _whole(where: str, words: list[str]) -> list[int]:
    if not all(re.fullmatch(r"[-+]?\d{1,9}", w) for w in words):
        raise SceneError(f"{where}: expected whole numbers, got {', '.join(words)[:60]!r}; {_HELP}")
    return [int(w) for w in words]


def is_gmsh(source: str) -> bool:
    path = Path(source)
    if path.suffix.lower() != ".geo" or not path.is_file():
        return False
    with open_mesh(path) as file:
        return _OWN.search(file.read(_HEAD)) is not None


FORMAT = SceneFormat("a .geo file of Gmsh", is_gmsh, read_gmsh)
