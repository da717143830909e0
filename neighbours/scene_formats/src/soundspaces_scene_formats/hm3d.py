"""HM3D: `<id>.semantic.glb`, whose pictures are painted in a colour for each thing, and `<id>.semantic.txt`, which
says of each colour what the thing is (`id,RRGGBB,"category",region`). Labels are the categories. Z up, metres.

A face has the colour of the texel that lies nearest to the mean of its texture coordinates, clamped to the
picture's edge, without filters or conversion. So reads habitat-sim (`ResourceManager::loadTextures`; rows:
`HM3DSemanticScene.cpp`; names and layout: its DATASETS.md). Its stages are Z up although glTF says Y up:
`hm3d_annotated_basis.scene_dataset_config.json` of matterport/habitat-matterport-3dresearch, versions 0.1 and 0.2.
Without the two files a scene is the mesh of `<id>.glb` or `<id>.basis.glb`, whose pictures are not opened.
"""

from __future__ import annotations

import io
import warnings
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from soundspaces_sim import SceneError
from soundspaces_sim.parts import (
    GLTF_PLACES as PLACES,
    MOST_SCENE_BYTES as MOST_BYTES,
    GltfBuffers as Buffers,
    GltfTree as Tree,
    LabelledMesh,
    SceneFormat,
    find_hm3d,
    gltf_base_color as base_color,
    gltf_uri as read_uri,
    gltf_view as view_of,
    install_hint,
    label_rows,
    mesh_in_our_words as in_our_words,
    open_gltf,
    open_mesh,
    open_with_trimesh,
    plain_gltf,
    read_mesh,
    read_text,
    triangle_areas as areas,
)

MOST_PIXELS = 2**26  # of one picture, which is held while it is read
MOST_IN_ALL = 2**28  # of all pictures, or so many for each byte of the file if that is more:
_A_BYTE = 32
_MOST_SCANS = 100  # of a JPEG: each is a pass over the whole picture
_KINDS = ("PNG", "JPEG")
_MODES = ("1", "L", "LA", "P", "PA", "RGB", "RGBA")


@dataclass(frozen=True)
class Pictures:
    """`of_material`: number of the picture of each material's base colour, None where there is none."""

    path: Path
    tree: Tree
    buffers: Buffers
    of_material: tuple[int | None, ...]

    def read(self, number: int) -> np.ndarray:
        """(H, W, 3) bytes of a picture: red, green, blue, from the first row down. Raises `SceneError`."""
        with self._opened(number) as picture:
            if picture.mode not in _MODES:
                raise ValueError(f"picture {number} is {picture.mode}, expected eight bits for a colour")
            return np.asarray(picture.convert("RGB"))

    def pixels(self, number: int) -> int:
        """How many a picture declares. Raises `SceneError`."""
        with self._opened(number) as picture:
            return int(picture.width * picture.height)

    def _opened(self, number: int) -> Any:
        """A picture, of which only the head has been read."""
        try:
            from PIL import Image, UnidentifiedImageError
        except ImportError:
            raise SceneError(
                f"{self.path}: labels are in pictures, which need the pillow package: {install_hint('hm3d')}"
            ) from None
        data = self._bytes(number)
        large = f"{self.path}: picture {number} has more than {MOST_PIXELS:,} pixels, which is the limit"
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # our limit is below Pillow's
                picture = Image.open(io.BytesIO(data), formats=_KINDS)
        except Image.DecompressionBombError:
            raise SceneError(large) from None
        except UnidentifiedImageError:
            raise SceneError(
                f"{self.path}: picture {number} is neither PNG nor JPEG, or it is damaged"
            ) from None
        if picture.width * picture.height > MOST_PIXELS:
            raise SceneError(large)
        if picture.format == "JPEG" and data.count(b"\xff\xda") > _MOST_SCANS:
            raise SceneError(f"{self.path}: picture {number} has more than {_MOST_SCANS} scans")
        return picture

    def _bytes(self, number: int) -> bytes:
        image = self.tree["images"][number]
        if "bufferView" in image:
            return view_of(self.tree, self.buffers, image["bufferView"])
        if not isinstance(image.get("uri"), str):
            raise ValueError(f"picture {number} is nowhere")
        return read_uri(self.path, image["uri"], "picture", MOST_BYTES)


def pictures_of(path: Path, tree: Tree, buffers: Buffers, size: int) -> Pictures:
    """The pictures of a file of `size` bytes that its materials' base colours use. Raises `SceneError`."""
    found = Pictures(
        path, tree, buffers, tuple(_number(path, tree, m) for m in tree.get("materials", []))
    )
    total = sum(found.pixels(n) for n in {n for n in found.of_material if n is not None})
    if total > max(MOST_IN_ALL, _A_BYTE * size):
        raise SceneError(
            f"{path}: {size:,} bytes hold pictures of {total:,} pixels in all, {MOST_IN_ALL:,} is the limit"
        )
    return found


def _number(path: Path, tree: Tree, material: Tree) -> int | None:
    """Of the picture of a material's base colour."""
    color = base_color(material)
    if color is None:
        return None
    texture = tree["textures"][color["index"]]
    if "KHR_texture_transform" in color.get("extensions", {}):
        raise SceneError(
            f"{path}: its texture coordinates are transformed (KHR_texture_transform), which is not read"
        )
    source = texture.get("source")
    if source is None and texture.get("extensions"):
        raise SceneError(
            f"{path}: its pictures are no PNG or JPEG, but {', '.join(sorted(texture['extensions']))}"
        )
    if type(source) is not int or source < 0:
        raise ValueError(f"a texture's picture is {source!r:.40}, expected a number")
    return source


MOST_TEXT = 256 * 2**20  # bytes
_HEAD = "HM3D Semantic Annotations"
_MESH, _TEXT = ".semantic.glb", ".semantic.txt"
_BLACK = 0
_NOTE = "Z is taken as up: so it is in HM3D, although glTF says Y up (override with up=)"


def load_hm3d(mesh: Path) -> LabelledMesh:
    """Read a scene with semantics; each face's label is the category of its colour. Raises `SceneError`."""
    name = mesh.name.removesuffix(_MESH)
    table = mesh.with_name(name + _TEXT)
    for file, other in ((mesh, table), (table, mesh)):
        if not file.exists():
            raise SceneError(
                f"{other}: {file.name} is missing beside it; HM3D's semantic scenes have both (give {name}.glb for "
                "the mesh without labels)"
            )
    category_of, notes = _read_rows(table)
    vertices, faces, colors = _painted(mesh)
    labels, rows = label_rows(colors, category_of, set(category_of.values()) - {""})
    known = np.isin(colors, [*category_of])
    if not known.all():
        notes.append(_note(table, areas(vertices[faces]), colors, known))
    return LabelledMesh(vertices, faces, labels, rows, name, (_NOTE, *notes))


def _read_rows(path: Path) -> tuple[dict[int, str], list[str]]:
    """Category by colour, and notes. Of a colour that stands twice the last one holds, as in habitat-sim."""
    lines = read_text(path, SceneError, "file", MOST_TEXT).splitlines()
    if not lines or _HEAD not in lines[0]:
        found = lines[0].strip()[:40] if lines else "an empty file"
        raise SceneError(f"{path}: expected '{_HEAD}' in the first line, got {found!r}")
    category_of: dict[int, str] = {}
    twice = set()
    for number, line in enumerate(lines[1:], 2):
        if not line.strip():
            continue
        head, mark, rest = line.partition('"')
        category, end, region = rest.rpartition('"')
        try:
            thing, color, after = head.split(",")
            if not (mark and end) or after.strip() or not region.strip().startswith(","):
                raise ValueError
            int(thing), int(region.strip(" ,"))
            value = int(color.strip(), 16)
            if not 0 <= value < 2**24:
                raise ValueError
        except ValueError:
            raise SceneError(
                f'{path}, line {number}: expected `id,RRGGBB,"category",region`, got {line[:60]!r}'
            ) from None
        category = category.strip()
        if category_of.setdefault(value, category) != category:
            twice.add(value)
        category_of[value] = category
    if not category_of:
        raise SceneError(f"{path}: no colour has a category; is the file complete?")
    if not twice:
        return category_of, []
    several = (
        f"{len(twice)} colours stand for several categories in {path.name}, of which the last holds"
    )
    return category_of, [f"{several}: {_some(sorted(twice))}"]


def _painted(path: Path) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Vertices (V, 3), faces (F, 3), colours (F,) as 0xRRGGBB, -1 where there is none."""
    with open_mesh(path) as file, in_our_words(path):
        data = file.read()
        tree, buffers = open_gltf(path, data)
        pictures = pictures_of(path, tree, buffers, len(data))
        plain = io.BytesIO(plain_gltf(tree, painted=True))
        scene = open_with_trimesh(path, plain, "gltf", buffers)
        parts = [m for m in scene.dump() if len(getattr(m, "faces", ()))] if scene.geometry else []
        if not parts:
            raise SceneError(f"{path}: the mesh has no faces (a point cloud?); need triangles")
        if all(number is None for number in pictures.of_material):
            raise SceneError(
                f"{path}: no material has a picture (baseColorTexture) with the colours of things; colours of "
                f"vertices are not read (give {path.name.removesuffix(_MESH)}.glb for the mesh without labels)"
            )
        colors = _colors(parts, pictures)
    offsets = np.cumsum([0] + [len(m.vertices) for m in parts])
    vertices = np.concatenate([np.asarray(m.vertices, float) for m in parts])
    faces = np.concatenate(
        [np.asarray(m.faces, np.int64) + o for m, o in zip(parts, offsets, strict=False)]
    )
    return vertices, faces, colors


def _colors(parts: list[Any], pictures: Pictures) -> np.ndarray:
    """The colours of all parts' faces, in their order; one picture is held at a time."""
    out = [np.full(len(m.faces), -1, np.int64) for m in parts]
    of_picture: dict[int, list[int]] = {}
    for i, part in enumerate(parts):
        name = str(getattr(getattr(part.visual, "material", None), "name", None))
        picture = pictures.of_material[int(name)] if name.isdecimal() else None
        if picture is not None and PLACES in part.vertex_attributes:
            of_picture.setdefault(picture, []).append(i)
    for number, rows in of_picture.items():
        texels = pictures.read(number)
        for i in rows:
            places = np.asarray(parts[i].vertex_attributes[PLACES])
            out[i] = _nearest(texels, _middles(places, parts[i].faces))
    return np.concatenate(out)


def _middles(places: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """(F, 2) means of the texture coordinates of faces' corners."""
    corners = np.asarray(places, float)[faces]
    if places.dtype.kind == "u":  # shares in whole numbers (glTF 2.0, 3.7.2.1)
        corners = corners / np.iinfo(places.dtype).max
    middles = corners.mean(axis=1)
    if not np.isfinite(middles).all():
        raise ValueError("texture coordinates are not finite")
    return np.asarray(middles)


def _nearest(texels: np.ndarray, places: np.ndarray) -> np.ndarray:
    """Colours 0xRRGGBB at texture coordinates (F, 2) of a picture (H, W, 3), whose first row is at 0."""
    size = np.array(texels.shape[1::-1])
    column, row = np.clip(places * size, 0, size - 1).astype(np.int64).T
    red, green, blue = texels[row, column].astype(np.int64).T
    return np.asarray(red << 16 | green << 8 | blue)


def _note(table: Path, area: np.ndarray, colors: np.ndarray, known: np.ndarray) -> str:
    """What share of the faces has a colour without a row."""

    def share(which: np.ndarray) -> str:
        part = 100.0 * area[which].sum() / max(area.sum(), 1e-300)
        return f"{int(which.sum())} faces ({part:.1f} % of the area)"

    lost = ~known
    other = np.unique(colors[lost & (colors > _BLACK)])
    which = (
        [f"{share(colors == _BLACK)} black, which nobody annotated"] if (colors[lost] == 0).any() else []
    )
    which += [f"{share(colors < 0)} without a picture"] if (colors < 0).any() else []
    which += [f"{len(other)} other colours: {_some(other.tolist())}"] if len(other) else []
    return f"{share(lost)} have no row in {table.name}, and no label: {'; '.join(which)}"


def _some(colors: list[int], most: int = 5) -> str:
    more = f" and {len(colors) - most} more" if len(colors) > most else ""
    return ", ".join(f"{color:06X}" for color in colors[:most]) + more


def _read(source: str) -> LabelledMesh:
    found = find_hm3d(Path(source))
    assert found is not None
    if found.name.endswith(_MESH):
        return load_hm3d(found)
    mesh = read_mesh(str(found))
    return replace(mesh, up="z", notes=(_NOTE, *mesh.notes))


FORMAT = SceneFormat(
    "an HM3D scene's folder (<id>.semantic.glb and <id>.semantic.txt, or <id>.glb) or one of these files",
    lambda source: find_hm3d(Path(source)) is not None,
    _read,
)
