"""IFC building models (.ifc) by the ifcopenshell package. Z up, metres, in world coordinates.

Every physical element is meshed, spaces and openings are not (openings are cut out of their walls). A label
combines what the model says of a face, from the general to the particular: class, type, materials, surface style;
"wall / Basic Wall 200 / Concrete". Storeys are named in the notes.
"""

from __future__ import annotations

import json
import re
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from soundspaces_sim import SceneError
from soundspaces_sim.parts import (
    LabelledMesh,
    SceneFormat,
    concatenate_parts,
    file_size as size_of,
    install_hint,
    open_mesh,
)

_ARRAYS, _TEXTS = "mesh.npz", "texts.json"
# What the process may take, and more for each byte of the file.
_SECONDS, _BYTES_A_SECOND = 300, 100_000
_MEMORY, _TIMES = 4 * 2**30, 100
_NOT_BUILT = (
    "IfcSpace",
    "IfcSpatialZone",
    "IfcOpeningElement",
    "IfcVirtualElement",
    "IfcAnnotation",
    "IfcGrid",
)


def read_ifc(source: str) -> LabelledMesh:
    """Read an IFC model. Raises `SceneError`.

    In a process of its own: some damaged files end the parser, which is C++, by a signal.
    """
    path = Path(source)
    if find_spec("ifcopenshell") is None:
        raise SceneError(f"{path}: IFC files need the ifcopenshell package: {install_hint('ifc')}")
    with open_mesh(path) as file:
        size = size_of(file)
    seconds, memory = _SECONDS + size // _BYTES_A_SECOND, _MEMORY + _TIMES * size
    with tempfile.TemporaryDirectory() as scratch:
        command = [sys.executable, "-P", "-m", __name__]
        command += [str(path), scratch, str(seconds), str(memory)]
        try:
            done = subprocess.run(
                command, capture_output=True, text=True, errors="replace", timeout=seconds
            )
        except subprocess.TimeoutExpired as error:
            raise SceneError(
                f"{path}: cannot be read as an IFC model in {seconds} s; is it damaged? "
                "Export walls, floors and furniture alone, or another format"
            ) from error
        if done.returncode < 0:
            raise SceneError(
                f"{path}: cannot be read as an IFC model: ifcopenshell was ended by signal {-done.returncode}; the "
                "file is damaged, or beyond it"
            )
        if done.returncode:
            last = done.stderr.strip().splitlines()[-1:] or ["no message"]
            raise SceneError(f"{path}: cannot be read as an IFC model ({last[0]})")
        texts = json.loads((Path(scratch) / _TEXTS).read_text("utf-8"))
        with np.load(Path(scratch) / _ARRAYS, allow_pickle=False) as arrays:
            vertices, faces, face_label = (arrays[name] for name in ("vertices", "faces", "face_label"))
    if len(faces) == 0:
        raise SceneError(f"{path}: no element of this IFC model has a shape; need walls, slabs, …")
    named = ", ".join(f"{name} at {z:.2f} m" for z, name in texts["storeys"])
    notes = (f"storeys: {named}",) if named else ()
    return LabelledMesh(vertices, faces, tuple(texts["labels"]), face_label, path.stem, notes)


def _convert(path: str, folder: Path) -> None:
    """What the process does: the model's arrays and texts as files in `folder`."""
    import ifcopenshell
    import ifcopenshell.geom
    import ifcopenshell.util.element
    import ifcopenshell.util.placement
    import ifcopenshell.util.unit

    model = ifcopenshell.open(path)
    parts = [part for _, part in sorted(_parts(ifcopenshell, model), key=lambda item: item[0])]
    empty = np.empty((0, 3)), np.empty((0, 3), np.int64), (), np.empty(0, np.int64)
    vertices, faces, labels, face_label = concatenate_parts(parts) if parts else empty
    np.savez(folder / _ARRAYS, vertices=vertices, faces=faces, face_label=face_label)
    texts = {"labels": list(labels), "storeys": _storeys(ifcopenshell, model)}
    (folder / _TEXTS).write_text(json.dumps(texts), "utf-8")


def _parts(ifc: Any, model: Any) -> Iterator[tuple[tuple[int, int], tuple[np.ndarray, np.ndarray, str]]]:
    """((element, style), (vertices in m, faces, label)) of every element's faces of one style."""
    settings = ifc.geom.settings()
    settings.set("use-world-coords", True)
    # Threads would not change the shapes, but nor do they pay for models of a building's size.
    excluded = [name for name in _NOT_BUILT if _knows(model, name)]
    elements = [e for name in excluded for e in model.by_type(name)]
    iterator = ifc.geom.iterator(settings, model, 1, exclude=elements or None)
    if not iterator.initialize():
        return
    while True:
        shape = iterator.get()
        element = model.by_id(shape.id)
        geometry = shape.geometry
        vertices = np.array(geometry.verts, float).reshape(-1, 3)
        faces = np.array(geometry.faces, np.int64).reshape(-1, 3)
        style = np.array(geometry.material_ids, np.int64)
        names = _words(ifc, element)
        for k in np.unique(style) if len(faces) else ():
            used, chosen = np.unique(faces[style == k], return_inverse=True)
            own = str(geometry.materials[int(k)].name) if k >= 0 else ""
            # Without a surface style the shape is named after the element's class: the class is noted already.
            own = "" if own.lower().startswith("ifc") else own
            label = " / ".join(dict.fromkeys(n for n in (*names, own) if n))
            yield (int(shape.id), int(k)), (vertices[used], chosen.reshape(-1, 3), label)
        if not iterator.next():
            return


def _knows(model: Any, name: str) -> bool:
    """Whether the model's schema has a class."""
    try:
        model.by_type(name)
    except RuntimeError:
        return False
    return True


def _words(ifc: Any, element: Any) -> list[str]:
    """Class, type and materials of an element, in words."""
    kind = re.sub(r"(?<=[a-z])(?=[A-Z])", " ", element.is_a().removeprefix("Ifc")).lower()
    kind = re.sub(r" (standard case|elemented case|element)$", "", kind)
    predefined = ifc.util.element.get_predefined_type(element) or ""
    if predefined not in ("", "NOTDEFINED", "USERDEFINED", "STANDARD", "SOLIDWALL"):
        kind = f"{kind} / {predefined.lower()}"
    of_type = ifc.util.element.get_type(element)
    materials = [str(m.Name or "") for m in ifc.util.element.get_materials(element)]
    return [kind, str((of_type.Name if of_type is not None else None) or ""), *materials]


def _storeys(ifc: Any, model: Any) -> list[tuple[float, str]]:
    """(height m, name) of the storeys, from below."""
    metre = ifc.util.unit.calculate_unit_scale(model)
    return sorted(
        (
            float(ifc.util.placement.get_local_placement(s.ObjectPlacement)[2, 3]) * metre,
            str(s.Name or s.LongName or "storey"),
        )
        for s in model.by_type("IfcBuildingStorey")
    )


FORMAT = SceneFormat(
    "an IFC model (.ifc)",
    lambda source: Path(source).suffix.lower() == ".ifc" and Path(source).is_file(),
    read_ifc,
)


def _limit(seconds: int, memory: int) -> None:
    """End this process after so many seconds of processor time, and refuse it more than so many bytes, where the
    system can."""
    try:
        import resource
    except ImportError:  # Windows
        return
    resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds))
    resource.setrlimit(resource.RLIMIT_AS, (memory, memory))


if __name__ == "__main__":
    _limit(int(sys.argv[3]), int(sys.argv[4]))
    _convert(sys.argv[1], Path(sys.argv[2]))
