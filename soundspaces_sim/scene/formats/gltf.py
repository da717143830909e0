"""glTF files reduced to what is heard before trimesh reads them: nodes, triangles, names of materials.

Pictures are never opened. Buffers are read from the file itself, or from regular files beside it. What the
file declares, and how often it places it, is summed up first.
"""

from __future__ import annotations

import base64
import json
import math
import struct
from pathlib import Path
from typing import Any
from urllib.parse import unquote

from soundspaces_sim.core.errors import SceneError
from soundspaces_sim.core.io.untrusted import parse_json, read_bytes
from soundspaces_sim.scene.formats.limits import MOST_BYTES, check_corners, total_in_place
from soundspaces_sim.scene.formats.octave_material import SCATTERING, octave_material
from soundspaces_sim.scene.materials import MaterialTable

_JSON, _BIN = 0x4E4F534A, 0x004E4942
_SHAPES = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT2": 4, "MAT3": 9, "MAT4": 16}
_OVERLAP = 16  # times the bytes of all buffers that views and accessors may cover in all
_NODE = ("children", "mesh", "matrix", "translation", "rotation", "scale", "name")
_PRIMITIVE = ("indices", "mode", "material", "extensions")
_PACKED = ("KHR_draco_mesh_compression", "EXT_meshopt_compression", "KHR_meshopt_compression")
_FLOAT = 5126
#: A vertex attribute of trimesh's that holds texture coordinates, as they stand in the file.
PLACES = "_PLACES"
Tree = dict[str, Any]


class Buffers(dict[str, bytes]):
    """Stands for the files beside it: buffers by number."""


def read_gltf(path: Path, data: bytes) -> tuple[bytes, Buffers, dict[str, MaterialTable]]:
    """The plain glTF of a .gltf or .glb file's bytes, its buffers, and materials that it gives by name. Raises
    `SceneError`."""
    tree, buffers = open_gltf(path, data)
    return plain_gltf(tree), buffers, _materials(path, tree)


def open_gltf(path: Path, data: bytes) -> tuple[Tree, Buffers]:
    """The JSON of a .gltf or .glb file's bytes, and its buffers; what they may cost is looked at. Raises
    `SceneError`, or whatever a damaged file leads to."""
    text, chunks = _chunks(data) if data[:4] == b"glTF" else (data, [])
    tree = parse_json(text.decode("utf-8", "replace"), path, SceneError, "glTF file")
    if not isinstance(tree, dict):
        raise ValueError("expected a JSON object")
    _choose_scene(tree)
    _refuse_packed(path, tree)
    buffers = Buffers()
    known: dict[str, bytes] = {}
    for i, item in enumerate(tree.get("buffers", [])):
        buffers[str(i)] = _buffer(path, item, chunks, known)
    size = len(data) + sum(map(len, known.values()))
    _check_sizes(tree, sum(map(len, buffers.values())))
    check_corners(path, _corners(path, tree), size)
    return tree, buffers


def _choose_scene(tree: Tree) -> None:
    """Leave the scene that is shown: the one that the file names, or the first; in a file without any, all nodes
    that are in no other."""
    scenes, nodes = tree.get("scenes") or [], tree.get("nodes", [])
    if not scenes:
        inner = {child for node in nodes for child in node.get("children", [])}
        scenes = [{"nodes": [i for i in range(len(nodes)) if i not in inner]}]
    chosen = tree.get("scene", 0)
    if not isinstance(chosen, int) or isinstance(chosen, bool) or not 0 <= chosen < len(scenes):
        raise ValueError(f"it names scene {chosen!r:.40} of {len(scenes)}")
    tree["scene"], tree["scenes"] = 0, [scenes[chosen]]


def _refuse_packed(path: Path, tree: Tree) -> None:
    """Raise `SceneError` for meshes that only a decoder of their own can read."""
    primitives = [p for m in tree.get("meshes", []) for p in m.get("primitives", [])]
    holders = [*primitives, *tree.get("bufferViews", []), *tree.get("buffers", [])]
    named = [*tree.get("extensionsRequired", [])]
    named += [name for holder in holders for name in holder.get("extensions", {})]
    found = next((name for name in _PACKED if name in named), None)
    if found is not None:
        raise SceneError(
            f"{path}: its mesh is compressed ({found}), which is not read here; save it without mesh compression"
        )
    accessors = tree.get("accessors", [])
    for primitive in primitives:
        place = primitive["attributes"].get("POSITION")
        item = accessors[_number(place)] if place is not None else {}
        if item.get("normalized") and item.get("componentType") != _FLOAT:
            raise SceneError(
                f"{path}: its places are shares of whole numbers (KHR_mesh_quantization), which are not read here; "
                "save it with floats"
            )


def _materials(path: Path, tree: Tree) -> dict[str, MaterialTable]:
    """Of materials with `absorption` among their extras (Blender: custom properties): a share, or shares in octaves
    from 125 Hz on; likewise `scattering`."""
    out = {}
    for item in tree.get("materials", []):
        name, extras = item.get("name"), item.get("extras")
        if not (isinstance(name, str) and isinstance(extras, dict) and "absorption" in extras):
            continue
        where = f"{path}: material '{name[:60]}'"
        absorbed = _shares(f"{where}: absorption", extras["absorption"])
        scattered = _shares(f"{where}: scattering", extras.get("scattering", SCATTERING))
        out[name] = octave_material(where, f"{name} of {path.name}", absorbed, scattered)
    return out


def _shares(where: str, value: Any) -> list[float]:
    values = value if isinstance(value, list) else [value]
    if not all(isinstance(v, int | float) and not isinstance(v, bool) for v in values):
        raise SceneError(f"{where}: expected a share, or shares in octaves, got {value!r:.60}")
    return [float(v) for v in values]


def _chunks(data: bytes) -> tuple[bytes, list[bytes]]:
    """JSON and binary chunks of a GLB."""
    _, version, _ = struct.unpack_from("<III", data)
    if version != 2:
        raise ValueError(f"version {version} of GLB, expected 2")
    text, rest, at = b"", [], 12
    while at + 8 <= len(data):
        length, kind = struct.unpack_from("<II", data, at)
        chunk = data[at + 8 : at + 8 + length]
        if len(chunk) != length:
            raise ValueError("a chunk is longer than the file")
        if kind == _JSON:
            text = text or chunk
        elif kind == _BIN:
            rest.append(chunk)
        at += 8 + length
    return text, rest


def _buffer(path: Path, item: Tree, chunks: list[bytes], known: dict[str, bytes]) -> bytes:
    uri = item.get("uri")
    if uri is None:
        return chunks.pop(0)
    if not isinstance(uri, str):
        raise ValueError("a buffer's uri is no text")
    if uri not in known:
        known[uri] = read_uri(path, uri, "glTF buffer", MOST_BYTES)
    return known[uri]


def read_uri(path: Path, uri: str, what: str, most: int) -> bytes:
    """Bytes that a glTF file refers to: inline, or a file beside it. Raises `SceneError`."""
    if uri.startswith("data:"):
        return base64.b64decode(uri[uri.index("base64,") + 7 :])
    place = (path.parent / unquote(uri)).resolve()
    if not place.is_relative_to(path.parent.resolve()) or ":" in uri.split("/")[0]:
        raise SceneError(f"{path}: refers to {uri[:80]!r}, which is not a file beside it")
    return read_bytes(place, SceneError, what, most)


def _number(value: Any) -> int:
    if type(value) is not int or value < 0:
        raise ValueError(f"expected a whole number, got {value!r:.40}")
    return value


def _check_sizes(tree: Tree, size: int) -> None:
    """Raise unless views and accessors lie in the buffers, and cover them a few times at most."""
    views = tree.get("bufferViews", [])
    covered = sum(_number(v.get("byteLength")) for v in views)
    numbers = sum(_number(a.get("count")) * _SHAPES[a.get("type")] for a in tree.get("accessors", []))
    if max(covered, numbers) > _OVERLAP * size:
        raise ValueError(
            f"it declares {max(covered, numbers):,} bytes or numbers, and holds {size:,} bytes"
        )
    for view in views:
        _number(view.get("byteOffset", 0)), _number(view.get("buffer"))


def _corners(path: Path, tree: Tree) -> int:
    """Corners of all faces, in their places."""
    counts = [_number(a.get("count")) for a in tree.get("accessors", [])]
    meshes, nodes = tree.get("meshes", []), tree.get("nodes", [])
    weight_of_mesh = [
        sum(
            counts[_number(k)]
            for p in mesh.get("primitives", [])
            for k in (p["attributes"].get("POSITION"), p.get("indices"))
            if k is not None
        )
        for mesh in meshes
    ]
    children = {str(i): [str(c) for c in node.get("children", [])] for i, node in enumerate(nodes)}
    weight = {
        str(i): 1 + (weight_of_mesh[_number(node["mesh"])] if "mesh" in node else 0)
        for i, node in enumerate(nodes)
    }
    roots = {str(n) for scene in tree.get("scenes", []) for n in scene.get("nodes", [])}
    return sum(weight_of_mesh) + total_in_place(path, children, weight, sorted(roots))


def plain_gltf(tree: Tree, painted: bool = False) -> bytes:
    """The same scene without what is not heard; `painted`: materials are named by their numbers, and texture
    coordinates of their base colours are the vertices' attribute `PLACES`."""
    out: Tree = {k: tree[k] for k in ("asset", "scene", "bufferViews", "accessors") if k in tree}
    out["buffers"] = [{"uri": str(i)} for i in range(len(tree.get("buffers", [])))]
    out["scenes"] = [{"nodes": s.get("nodes", [])} for s in tree.get("scenes", [])]
    out["nodes"] = [{k: n[k] for k in _NODE if k in n} for n in tree.get("nodes", [])]
    materials = tree.get("materials", [])
    out["materials"] = [{k: m[k] for k in ("name",) if k in m} for m in materials]
    sets = None
    if painted:
        out["materials"] = [{"name": str(i)} for i in range(len(materials))]
        sets = [(base_color(m) or {}).get("texCoord", 0) for m in materials]
    out["meshes"] = [
        {
            **{k: m[k] for k in ("name",) if k in m},
            "primitives": [_primitive(p, sets) for p in m["primitives"]],
        }
        for m in tree.get("meshes", [])
    ]
    for node in out["nodes"]:
        for k in ("matrix", "translation", "rotation", "scale"):
            if not all(math.isfinite(x) for x in node.get(k, ())):
                raise ValueError(f"a node's {k} is not finite")
    return json.dumps(out).encode()


def base_color(material: Tree) -> Tree | None:
    """Which texture a material's colour is from: an object with `index`, and maybe `texCoord`; None if there is
    none."""
    return material.get("pbrMetallicRoughness", {}).get("baseColorTexture")


def view_of(tree: Tree, buffers: Buffers, number: Any) -> bytes:
    """The bytes of a buffer view."""
    view = tree["bufferViews"][_number(number)]
    start = _number(view.get("byteOffset", 0))
    return buffers[str(_number(view["buffer"]))][start : start + _number(view["byteLength"])]


def _primitive(primitive: Tree, sets: list[int] | None) -> Tree:
    """`sets`: of each material the number of its texture coordinates; None: they are left out."""
    found = {k: primitive[k] for k in _PRIMITIVE if k in primitive}
    attributes = primitive["attributes"]
    kept = {"POSITION": attributes["POSITION"]} if "POSITION" in attributes else {}
    if sets is not None and "material" in primitive:
        places = attributes.get(f"TEXCOORD_{sets[_number(primitive['material'])]}")
        kept |= {} if places is None else {PLACES: places}
    return {**found, "attributes": kept}
