"""COLLADA and IFC: what files say of units, axes and names, and damaged ones."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import soundspaces_sim as ss
from tests.scene.test_frames_and_names import ROOM, _names, _size


def _dae(path: Path, v: np.ndarray, asset: str) -> Path:
    """A room in COLLADA 1.4.1: floor and the rest of two materials, put in place by a node's matrix."""
    numbers = " ".join(f"{x:.6f}" for x in (v - [1.0, 2.0, 3.0]).ravel())
    floor = [k for k, n in enumerate(ROOM.normals) if abs(n[2]) > 0.9 and ROOM.corners[k, 0, 2] == 0.0]
    rest = [k for k in range(12) if k not in floor]
    triangles = "".join(
        f'<triangles count="{len(rows)}" material="s{i}"><input semantic="VERTEX" source="#v" offset="0"/>'
        f"<p>{' '.join(map(str, ROOM.faces[rows].ravel()))}</p></triangles>"
        for i, rows in enumerate((floor, rest))
    )
    materials = "".join(
        f'<material id="m{i}" name="{name}"><instance_effect url="#e"/></material>'
        for i, name in enumerate(("Parquet floor", "brick"))
    )
    bind = "".join(f'<instance_material symbol="s{i}" target="#m{i}"/>' for i in (0, 1))
    path.write_text(
        '<?xml version="1.0"?><COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">'
        f"<asset>{asset}</asset>"
        '<library_effects><effect id="e"><profile_COMMON><technique sid="t"><lambert/></technique></profile_COMMON>'
        f"</effect></library_effects><library_materials>{materials}</library_materials>"
        '<library_geometries><geometry id="g"><mesh><source id="p">'
        f'<float_array id="pa" count="{v.size}">{numbers}</float_array><technique_common>'
        f'<accessor source="#pa" count="{len(v)}" stride="3"><param name="X" type="float"/>'
        '<param name="Y" type="float"/><param name="Z" type="float"/></accessor></technique_common></source>'
        f'<vertices id="v"><input semantic="POSITION" source="#p"/></vertices>{triangles}</mesh></geometry>'
        '</library_geometries><library_visual_scenes><visual_scene id="s"><node>'
        "<matrix>1 0 0 1 0 1 0 2 0 0 1 3 0 0 0 1</matrix>"
        f'<instance_geometry url="#g"><bind_material><technique_common>{bind}</technique_common></bind_material>'
        "</instance_geometry></node></visual_scene></library_visual_scenes>"
        '<scene><instance_visual_scene url="#s"/></scene></COLLADA>'
    )
    return path


@pytest.mark.parametrize("up", ["X_UP", "Y_UP", "Z_UP"])
@pytest.mark.parametrize(("unit", "metre"), [('name="inch" meter="0.0254"', 0.0254), ('meter="1"', 1.0)])
def test_dae_says_unit_and_up(tmp_path: Path, up: str, unit: str, metre: float) -> None:
    """The same room, floor at z = 0, whatever the file's frame: Z_UP is not taken for Y, inches not for
    centimetres."""
    x, y, z = (ROOM.vertices / metre).T
    v = {"X_UP": [z, x, y], "Y_UP": [x, z, -y], "Z_UP": [x, y, z]}[up]
    path = _dae(tmp_path / "room.dae", np.stack(v, axis=1), f"<unit {unit}/><up_axis>{up}</up_axis>")
    scene = ss.load_scene(path)
    np.testing.assert_allclose(scene.bounds, [[0.0, 0.0, 0.0], [6.0, 4.0, 2.5]], atol=1e-4)
    assert _names(scene) == {"parquet": 24.0, "brick": 74.0}
    scaled = ss.load_scene(path, unit="cm", ceiling=False)
    np.testing.assert_allclose(_size(scaled), np.array([6.0, 4.0, 2.5]) / metre * 0.01, rtol=1e-4)


def test_dae_without_unit_and_a_bad_one(tmp_path: Path) -> None:
    x, y, z = ROOM.vertices.T
    v = np.stack([x, z, -y], axis=1)
    np.testing.assert_allclose(
        _size(ss.load_scene(_dae(tmp_path / "a.dae", v * 1000.0, ""))), [6.0, 4.0, 2.5]
    )
    for bad in ("0", "-1", "nan"):
        with pytest.raises(ss.SceneError, match=r"bad\.dae"):
            ss.load_scene(_dae(tmp_path / "bad.dae", v, f'<unit meter="{bad}"/>'))
    (tmp_path / "no.dae").write_text("nonsense")
    with pytest.raises(ss.SceneError, match=r"no\.dae.*COLLADA"):
        ss.load_scene(tmp_path / "no.dae")


def _ifc(path: Path) -> Path:
    """A storey at 3 m with a room of 5 x 4 x 2.5 m in millimetres: four concrete walls, one with an opening, a
    slab of a type, a door, and the room itself as a space, which is no surface."""
    ifc = pytest.importorskip("ifcopenshell", reason="IFC needs ifcopenshell (extra `ifc`)")
    from importlib import import_module

    def run(what: str, *args: object, **kw: object) -> Any:
        module, name = what.split(".")
        return getattr(import_module(f"ifcopenshell.api.{module}"), name)(*args, **kw)

    model = ifc.file(schema="IFC4")
    project = run("root.create_entity", model, ifc_class="IfcProject", name="p")
    length = run("unit.add_si_unit", model, unit_type="LENGTHUNIT", prefix="MILLI")
    run("unit.assign_unit", model, units=[length])
    context = run("context.add_context", model, context_type="Model")
    body = run(
        "context.add_context",
        model,
        context_type="Model",
        context_identifier="Body",
        target_view="MODEL_VIEW",
        parent=context,
    )
    building = run("root.create_entity", model, ifc_class="IfcBuilding", name="b")
    storey = run("root.create_entity", model, ifc_class="IfcBuildingStorey", name="First floor")
    run("aggregate.assign_object", model, products=[building], relating_object=project)
    run("aggregate.assign_object", model, products=[storey], relating_object=building)

    def put(element: object, x: float, y: float, z: float) -> None:
        matrix = np.eye(4)
        matrix[:3, 3] = x, y, z
        run("geometry.edit_object_placement", model, product=element, matrix=matrix, is_si=True)

    put(storey, 0.0, 0.0, 3.0)

    def solid(kind: str, name: str, low: tuple[float, ...], size: tuple[float, ...]) -> object:
        element = run("root.create_entity", model, ifc_class=kind, name=name)
        points = [(0.0, 0.0), (size[0], 0.0), (size[0], size[1]), (0.0, size[1]), (0.0, 0.0)]
        curve = model.createIfcPolyline(
            [model.createIfcCartesianPoint([a * 1e3, b * 1e3]) for a, b in points]
        )
        profile = model.createIfcArbitraryClosedProfileDef("AREA", None, curve)
        shape = run(
            "geometry.add_profile_representation", model, context=body, profile=profile, depth=size[2]
        )
        run("geometry.assign_representation", model, product=element, representation=shape)
        if kind == "IfcSpace":
            run("aggregate.assign_object", model, products=[element], relating_object=storey)
        elif kind != "IfcOpeningElement":
            run("spatial.assign_container", model, products=[element], relating_structure=storey)
        put(element, *low)
        return element

    concrete = run("material.add_material", model, name="Concrete C30")
    walls = [
        solid("IfcWall", "w", low, size)
        for low, size in (
            ((0, 0, 3), (5, 0.2, 2.5)), ((0, 3.8, 3), (5, 0.2, 2.5)), ((0, 0.2, 3), (0.2, 3.6, 2.5)), ((4.8, 0.2, 3), (0.2, 3.6, 2.5)),
        )
    ]  # fmt: skip
    run("material.assign_material", model, products=walls, material=concrete)
    opening = solid("IfcOpeningElement", "o", (2.0, -0.1, 3.0), (0.9, 0.4, 2.0))
    run("feature.add_feature", model, feature=opening, element=walls[0])
    slab = solid("IfcSlab", "s", (0, 0, 2.8), (5, 4, 0.2))
    kind = run("root.create_entity", model, ifc_class="IfcSlabType", name="Parquet on joists")
    run(
        "type.assign_type",
        model,
        related_objects=[slab],
        relating_type=kind,
        should_map_representations=False,
    )
    solid("IfcDoor", "d", (2.0, 0.1, 3.0), (0.9, 0.04, 2.0))
    solid("IfcSpace", "r", (0.2, 0.2, 3.0), (4.6, 3.6, 2.5))
    model.write(str(path))
    return path


def test_ifc(tmp_path: Path) -> None:
    """Metres though the file has millimetres; materials, types and classes as labels; storeys noted; no space."""
    scene = ss.load_scene(_ifc(tmp_path / "house.ifc"), ceiling=False)
    np.testing.assert_allclose(scene.bounds, [[0, 0, 2.8], [5, 4, 5.5]], atol=1e-6)
    assert {"wall / Concrete C30", "slab / Parquet on joists", "door"} == set(scene.labels)
    areas = _names(scene)
    walls = 2 * (2 * (5 * 2.5 + 0.2 * 2.5 + 5 * 0.2)) + 2 * (2 * (3.6 * 2.5 + 0.2 * 2.5 + 3.6 * 0.2))
    opening = -2 * 0.9 * 2.0 - 0.9 * 0.2 + 2 * 2.0 * 0.2 + 0.9 * 0.2
    assert areas["concrete"] == pytest.approx(walls + opening, abs=1e-3)
    assert areas["parquet"] == pytest.approx(2 * (20 + 5 * 0.2 + 4 * 0.2), abs=1e-3)
    assert areas["wood-thick"] == pytest.approx(2 * (0.9 * 2 + 0.04 * 2 + 0.9 * 0.04), abs=1e-3)
    assert "storeys: First floor at 3.00 m" in scene.notes
    np.testing.assert_array_equal(
        ss.load_scene(tmp_path / "house.ifc", ceiling=False).corners, scene.corners
    )


def test_bad_ifc(tmp_path: Path) -> None:
    pytest.importorskip("ifcopenshell", reason="IFC needs ifcopenshell (extra `ifc`)")
    (tmp_path / "bad.ifc").write_text("nonsense")
    with pytest.raises(ss.SceneError, match=r"bad\.ifc.*IFC"):
        ss.load_scene(tmp_path / "bad.ifc")


def test_an_ifc_that_ends_its_parser(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """ifcopenshell, which is C++, crashes on some damaged files: that ends its own process, not ours."""
    pytest.importorskip("ifcopenshell", reason="IFC needs ifcopenshell (extra `ifc`)")
    (tmp_path / "ifcopenshell.py").write_text("import os, signal; os.kill(os.getpid(), signal.SIGSEGV)")
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(tmp_path), os.environ.get("PYTHONPATH", "")]))
    (tmp_path / "bad.ifc").write_text("ISO-10303-21;")
    with pytest.raises(ss.SceneError, match=r"bad\.ifc: .*ifcopenshell was ended by signal 11"):
        ss.load_scene(tmp_path / "bad.ifc")
