"""Matterport3D: `<scene>.house` (ASCII 1.1) with a semantic PLY, Habitat's form or the native one.

Labels are mpcat40 categories. Z up, metres.
"""

from __future__ import annotations

from pathlib import Path

from soundspaces_sim.core.errors import SceneError
from soundspaces_sim.core.io.untrusted import read_text
from soundspaces_sim.scene.formats.ply import read_labelled_ply
from soundspaces_sim.scene.labelled import LabelledMesh, SceneFormat, label_rows

MOST_HOUSE = 256 * 2**20  # bytes
_VERSION = "ASCII 1.1"
_HOUSE, _MESH, _PLY = ".house", ".glb", "_semantic.ply"
_ENDS = (_HOUSE, _MESH, _PLY)


def find_matterport(path: Path) -> tuple[Path, Path] | None:
    """The .house file and the PLY of a scene, of its folder or one of its files; None if it is another's.

    Raises `SceneError` for a .glb with a .house file beside it and no PLY: labels and what is up would be lost.
    """
    if path.is_dir():
        houses = [h for f in (path, path / "house_segmentations") for h in sorted(f.glob("*.house"))]
    else:
        end = next((e for e in _ENDS if path.name.endswith(e) and path.name != e), None)
        house = path.with_name(path.name.removesuffix(end) + _HOUSE) if end else path
        houses = [house] if end and path.is_file() and house.is_file() else []
    for house in houses:
        for end in (_PLY, ".ply"):
            if house.with_name(house.stem + end).is_file():
                return house, house.with_name(house.stem + end)
    if houses and path.suffix == _MESH:
        name = houses[0].name
        raise SceneError(
            f"{path}: {name} beside it says that this is a scene of Matterport3D, but {path.stem}{_PLY} is "
            "missing, which has labels; put it there, or remove the .house file"
        )
    return None


def load_matterport(source: str) -> LabelledMesh:
    """Read a scene. Raises `SceneError`."""
    files = find_matterport(Path(source))
    assert files is not None
    house, ply = files
    categories, by_mapping, objects = _read_house(house)
    vertices, faces, numbers = read_labelled_ply(ply, ("object_id", "face_category"))
    if "object_id" in numbers:  # Habitat's form: rows of the O lines
        key, table = numbers["object_id"], objects
    elif "face_category" in numbers:  # native: index into category_mapping.tsv
        key, table = numbers["face_category"], by_mapping
    else:
        raise SceneError(
            f"{ply}: faces have neither object_id (Habitat's form) nor face_category (native)"
        )
    labels, rows = label_rows(key, table, categories.values())
    return LabelledMesh(vertices, faces, labels, rows, house.stem)


def _read_house(path: Path) -> tuple[dict[int, str], dict[int, str], dict[int, str]]:
    """mpcat40 names by category index, by mapping index, and by object index."""
    lines = read_text(path, SceneError, "file", MOST_HOUSE).splitlines()
    if not lines or lines[0].strip() != _VERSION:
        found = lines[0].strip()[:40] if lines else "an empty file"
        raise SceneError(f"{path}: expected '{_VERSION}' in the first line, got {found!r}")
    categories: dict[int, str] = {}
    by_mapping: dict[int, str] = {}
    category_of: dict[int, int] = {}
    for number, line in enumerate(lines[1:], 2):
        fields = line.split()
        if not fields or fields[0] not in ("C", "O"):
            continue
        try:
            if fields[0] == "C":
                name = fields[5]
                categories[int(fields[1])] = by_mapping[int(fields[2])] = name
            else:
                category_of[int(fields[1])] = int(fields[3])
        except (IndexError, ValueError) as error:
            raise SceneError(
                f"{path}, line {number}: expected `C cat mapping name mpcat40 mpcat40_name …` or "
                f"`O object region category …`, got {line[:60]!r}"
            ) from error
    if not categories:
        raise SceneError(f"{path}: no category (C line); is the file complete?")
    objects = {o: categories[c] for o, c in category_of.items() if c in categories}
    return categories, by_mapping, objects


FORMAT = SceneFormat(
    "a Matterport3D scene's folder (<scene>.house and <scene>_semantic.ply), or one of its files",
    lambda source: find_matterport(Path(source)) is not None,
    load_matterport,
)
