"""I-Simpa's PLY: faces have a `layer_id`, and an element `layer` after them has the names. Z up, metres."""

from __future__ import annotations

import struct
from pathlib import Path, PurePosixPath
from typing import NamedTuple
from xml.etree import ElementTree

import numpy as np

from soundspaces_sim import MaterialError, MaterialTable, SceneError
from soundspaces_sim.parts import (
    LabelledMesh,
    PlyElements as Elements,
    PlyLists as Lists,
    SceneFormat,
    open_mesh,
    parse_xml,
    ply_header,
    read_labelled_ply,
    unpacked_archive as unpacked,
)

# I-Simpa's projects (.proj): its mesh, its groups of surfaces, and the materials that were made in it.
#
# A project is a ZIP archive. `projet_config.xml` has the tree of the scene: groups of surfaces, each with the
# number of a material and a file of its faces; and materials of the user, with absorption and diffusion by thirds
# of octaves. `sceneMesh.bin` has the mesh. This layout was read off projects of versions 1.1.5 and 1.3.4 that are
# published with I-Simpa; there is no description of it. Materials of I-Simpa's own library are not in the
# project: such groups are labels without a material. Transmission is left out. Z up, metres.

_CONFIG, _MESH = "projet_config.xml", "sceneMesh.bin"
_READ = (_CONFIG, _MESH, ".finfo")
_VERTICES, _GROUP = 0, 1  # kinds of parts of a mesh
_NAME, _FACE = 256, 32  # bytes of a group's name and of a face


class _Group(NamedTuple):
    """A group of surfaces: `material` is its number in the project; `faces` (k, 2): part and row of each face."""

    name: str
    material: str
    faces: np.ndarray


def read_project(source: str) -> LabelledMesh:
    """Read a project; each face's label is the name of its group. Raises `SceneError`."""
    path = Path(source)
    with open_mesh(path) as file:
        files = _own(path, unpacked(path, file, lambda name: name.endswith(_READ)))
    for name in (_CONFIG, _MESH):
        if name not in files:
            raise SceneError(f"{path}: expected one {name} in this project, got none")
    tree = parse_xml(path, files[_CONFIG], "a project of I-Simpa")
    vertices, parts = _mesh(path, files[_MESH])
    starts = np.cumsum([0, *(len(faces) for faces in parts)])
    label = np.full(starts[-1], -1)
    groups = _groups(path, tree, files)
    for row, group in enumerate(groups):
        part, face = group.faces.T
        good = part < len(parts)
        if not (good.all() and (face < np.diff(starts)[part]).all()):
            raise SceneError(f"{path}: group '{group.name}' names faces that the mesh does not have")
        label[starts[part] + face] = row
    known, notes = _materials(path, tree)
    return LabelledMesh(
        vertices,
        np.concatenate(parts),
        tuple(group.name for group in groups),
        label,
        path.stem,
        notes,
        materials={g.name: known[g.material] for g in groups if g.material in known},
    )


def _own(path: Path, files: dict[str, bytes]) -> dict[str, bytes]:
    """The project's own files by their last names: a calculation leaves copies in folders of results, further
    below. Raises `SceneError`."""
    found: dict[str, tuple[int, bytes]] = {}
    twice = set()
    for name, content in files.items():
        place = PurePosixPath(name)
        depth, last = len(place.parts), found.get(place.name)
        if last is None or depth < last[0]:
            found[place.name] = depth, content
            twice.discard(place.name)
        elif depth == last[0]:
            twice.add(place.name)
    for name in twice & {_CONFIG, _MESH}:
        raise SceneError(f"{path}: expected one {name} in this project, got two")
    return {name: content for name, (_, content) in found.items() if name not in twice}


def _mesh(path: Path, data: bytes) -> tuple[np.ndarray, list[np.ndarray]]:
    """(V, 3) vertices, and faces (k, 3) of each part. Raises `SceneError`."""

    def broken(what: str) -> SceneError:
        return SceneError(f"{path}: sceneMesh.bin: {what}")

    vertices, parts, at = np.empty((0, 3)), [], 8  # after the version
    try:
        while True:
            kind, _, after = struct.unpack_from("<H2xII", data, at)
            end = at
            if kind == _VERTICES:
                (count,) = struct.unpack_from("<I", data, at + 12)
                vertices = np.frombuffer(data, "<f4", 3 * count, at + 16).reshape(-1, 3).astype(float)
                end = at + 16 + 12 * count
            elif kind == _GROUP:
                (count,) = struct.unpack_from("<I", data, at + 12 + _NAME)
                body = np.frombuffer(data, np.uint8, _FACE * count, at + 16 + _NAME)
                faces = np.ascontiguousarray(body.reshape(-1, _FACE)[:, :12])
                parts.append(faces.view("<u4").astype(np.int64).reshape(-1, 3))
                end = at + 16 + _NAME + _FACE * count
            if after == 0:
                break
            if after <= at:
                raise broken("its parts go in a circle")
            if after < end:
                raise broken("its parts overlap")
            at = after
    except (struct.error, ValueError) as error:
        raise broken(f"it ends too early ({error})") from error
    if not parts or not sum(len(p) for p in parts):
        raise broken("it has no faces")
    if max(int(p.max(initial=0)) for p in parts) >= len(vertices):
        raise broken("a face has a corner that there is not")
    if not np.isfinite(vertices).all():
        raise broken("some coordinates are not finite (NaN or inf)")
    return vertices, parts


def _groups(path: Path, tree: ElementTree.Element, files: dict[str, bytes]) -> list[_Group]:
    """The groups of surfaces; a name that comes again gets a number."""
    out: list[_Group] = []
    names: set[str] = set()
    last: dict[str, int] = {}  # of each name that came again, the number that it got last
    free = dict(files)
    for element in tree.iterfind(".//sgroupes/gr"):
        name = given = element.get("name", "").strip() or "surfaces"
        while name in names:
            last[given] = last.get(given, 0) + 1
            name = f"{given} {last[given]}"
        names.add(name)
        file = element.get("facesFile", "")
        content = free.pop(file, b"")
        numbers = np.frombuffer(content[: len(content) // 4 * 4], "<u4").astype(np.int64)
        if not len(numbers) or len(numbers) != 1 + 2 * numbers[0]:
            raise SceneError(
                f"{path}: group '{name}': its file of faces {file!r} is missing, broken or another group's"
            )
        material = next((p.get("value", "") for p in element.iterfind("p[@name='idmat']")), "")
        out.append(_Group(name, material, numbers[1:].reshape(-1, 2)))
    return out


def _materials(
    path: Path, tree: ElementTree.Element
) -> tuple[dict[str, MaterialTable], tuple[str, ...]]:
    """The user's materials by number, and notes. Raises `SceneError`."""
    out: dict[str, MaterialTable] = {}
    through = []
    for element in tree.iter("usermat"):
        name = element.get("name", "")
        for spectrum in element.iterfind("materiau"):
            rows = sorted(_band(path, name, band) for band in spectrum if band.tag in ("p", "bfreq"))
            if not rows:
                raise SceneError(f"{path}: material '{name}' has no bands")
            at, absorbed, scattered, open_ = np.array(rows).T
            through += [name] if open_.any() else []
            try:
                table = MaterialTable(
                    (f"{name} of {path.name}",),
                    at,
                    absorbed[None],
                    scattered[None],
                    np.zeros((1, len(at))),
                )
            except MaterialError as error:
                raise SceneError(f"{path}: material '{name}': {error}") from error
            out[spectrum.get("idmateriau", "")] = table
    note = f"transmission through {', '.join(through[:8])} is left out"
    return out, (note,) if through else ()


def _band(path: Path, name: str, band: ElementTree.Element) -> tuple[float, float, float, float]:
    """Frequency, Hz, absorption, diffusion and whether sound passes; older projects have them as attributes."""
    given = dict(band.attrib) | {p.get("name", ""): p.get("value", "") for p in band.iterfind("p")}
    words = (
        given.get("name"),
        given.get("absorb"),
        given.get("diffusion"),
        given.get("transmission", "0"),
    )
    try:
        f, a, d, t = (float((w or "").replace(",", ".")) for w in words)
    except ValueError:
        raise SceneError(
            f"{path}: material '{name}': expected a frequency, absorption and diffusion, got {words[:3]}"
        ) from None
    return f, a, d, t


PROJECT = SceneFormat(
    "a project of I-Simpa (.proj)",
    lambda source: Path(source).suffix.lower() == ".proj" and Path(source).is_file(),
    read_project,
)


def read_isimpa(source: str) -> LabelledMesh:
    """Read a model; each face's label is the name of its layer. Raises `SceneError`."""
    path = Path(source)
    layers: list[str] = []

    def names(data: Elements) -> None:
        found = data["layer"]["layer_name"]
        if not isinstance(found, Lists) or found.values.dtype.kind == "f":
            raise ValueError("its layers have no names")
        layers.extend(bytes(n.astype(np.uint8)).decode("utf-8", "replace") for n in found)

    vertices, faces, numbers = read_labelled_ply(path, ("layer_id",), names)
    if "layer_id" not in numbers:
        raise SceneError(
            f"{path}: it has layers, but its faces have no layer_id; expected a PLY of I-Simpa"
        )
    labels = tuple(sorted(set(layers)))
    number = {name: i for i, name in enumerate(labels)}
    row = np.array([*(number[name] for name in layers), -1], np.int64)
    of = numbers["layer_id"]
    return LabelledMesh(
        vertices, faces, labels, row[np.where((of >= 0) & (of < len(layers)), of, -1)], path.stem
    )


def _detects(source: str) -> bool:
    path = Path(source)
    return path.suffix.lower() == ".ply" and path.is_file() and b"element layer " in ply_header(path)


FORMAT = SceneFormat("a PLY file of I-Simpa", _detects, read_isimpa)
