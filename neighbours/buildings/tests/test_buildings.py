"""Generated buildings: the same every time, closed, labelled, without gaps, walkable, furniture apart."""

from __future__ import annotations

import hashlib

import numpy as np
import pytest
import trimesh
from soundspaces_buildings.data import furniture, own_materials
from soundspaces_buildings.furnish import Floor
from soundspaces_buildings.registry import BUILDINGS, building_mesh, building_of, building_rooms
from soundspaces_buildings.shell import Room
from soundspaces_buildings.solids import Solid, inset, moved, triangles
from soundspaces_buildings.walkway import inside as inside_polygon

import soundspaces_sim as ss
from soundspaces_sim.scene.formats import elsewhere
from soundspaces_sim.scene.labelled import LabelledMesh
from soundspaces_sim.scene.labels import find_material, load_labels
from soundspaces_sim.scene.materials import stack_materials
from tests.marks import CI_SLOW

KINDS = list(BUILDINGS)
FEW = [(kind, 7) for kind in KINDS]
SHELL = ("wall", "floor", "ceiling", "window", "curtain", "rug", "mat", "stone", "column")

#: Of number 3, version 2 of homes, rooms and halls, 1 of others; what changes one changes the meshes of everybody's datasets.
DIGESTS = {
    "home": "fc8ae54a527e36ac",
    "room": "4b000f4c083c04a3",
    "office": "d58cf7ba839a4d8b",
    "classroom": "3a745ffb9ec81873",
    "hall": "2ef01eb0400b2784",
    "church": "35fc90d5e510fb9b",
}


def digest(mesh: LabelledMesh) -> str:
    sha = hashlib.sha256(np.ascontiguousarray(mesh.vertices, "<f8").tobytes())
    sha.update(np.ascontiguousarray(mesh.faces, "<i8").tobytes())
    sha.update("|".join(mesh.labels).encode())
    sha.update(np.ascontiguousarray(mesh.face_label, "<i8").tobytes())
    return sha.hexdigest()[:16]


@pytest.mark.parametrize("kind", KINDS)
def test_a_number_is_a_building(kind: str) -> None:
    assert digest(building_mesh(kind, 3)) == DIGESTS[kind], f"a new mesh needs a new version of '{kind}'"
    assert digest(building_mesh(kind, 4)) != DIGESTS[kind]


def test_the_core_names_all_types(monkeypatch: pytest.MonkeyPatch) -> None:
    assert set(elsewhere.BUILDINGS) == set(BUILDINGS)
    absent = elsewhere._BUILDING._replace(target="not_installed_here:read")
    monkeypatch.setattr(elsewhere, "_BUILDING", absent)
    with pytest.raises(ss.SceneError, match=r"home-7: .*pip install \./neighbours/buildings"):
        ss.load_scene("home-7")


def test_names_of_buildings() -> None:
    assert building_of("church-12") == ("church", 12) and building_of("flat-0") is None
    for name in ("church-", "church--1", "house-1", "room", "room-1234567890", "room-1x"):
        assert building_of(name) is None
    with pytest.raises(ss.SceneError, match=r"'home-<number>'.*'church-<number>'"):
        ss.load_scene("house-1")
    with pytest.raises(ss.SceneError, match="from 0 to 999999999, got -1"):
        building_mesh("home", -1)


def check_closed_and_labelled(mesh: LabelledMesh) -> None:
    shape = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    assert shape.is_watertight and shape.is_winding_consistent
    pieces = trimesh.graph.connected_component_labels(shape.face_adjacency, len(shape.faces))
    tetrahedra = np.einsum(
        "ij,ij->i", mesh.vertices[mesh.faces[:, 0]], shape.face_normals * shape.area_faces[:, None]
    )
    assert (np.bincount(pieces, tetrahedra / 3.0) > 0.0).all()  # every solid faces outwards
    own = {label: given.names[0] for label, given in mesh.materials.items()}
    known, table = load_labels(of_scene=own), stack_materials(None, mesh.materials.values())
    for label in mesh.labels:
        material, words = find_material(label, known, table)
        assert material is not None and not words, label  # found as a whole, so that no note is needed
    assert (mesh.face_label >= 0).all()
    things = {label.split("-")[0] for label in mesh.labels}
    assert {"wall", "floor", "ceiling", "door"} <= things


@pytest.mark.parametrize(("kind", "number"), FEW)
def test_solids_are_closed_and_labelled(kind: str, number: int) -> None:
    check_closed_and_labelled(building_mesh(kind, number))


def check_no_gap(mesh: LabelledMesh, rays: int = 4000) -> None:
    """From places in the air inside, every ray meets the outside of a solid: none gets out, or into one."""
    rng = np.random.default_rng(0)
    shape = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    low, high = shape.bounds
    directions = rng.standard_normal((rays, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    found = 0
    for _ in range(400):
        place = low + (high - low) * rng.random(3)
        axes = np.concatenate([np.eye(3), -np.eye(3)])
        face = shape.ray.intersects_first(np.repeat(place[None], 6, axis=0), axes)
        if (face < 0).any() or ((shape.face_normals[face] * axes).sum(axis=1) >= 0.0).any():
            continue  # outdoors, or in something
        above = mesh.labels[mesh.face_label[face[2]]]
        if not above.startswith(("ceiling", "lamp")):
            continue  # below a table, say
        found += 1
        face = shape.ray.intersects_first(np.repeat(place[None], rays, axis=0), directions)
        assert (face >= 0).all(), f"{mesh.name}: a ray from {place} gets out"
        cosine = (shape.face_normals[face] * directions).sum(axis=1)
        assert (cosine < 1e-6).all(), f"{mesh.name}: a ray from {place} gets into a solid"
        if found == 6:
            return
    assert found > 2, mesh.name


@pytest.mark.parametrize(("kind", "number"), FEW)
def test_no_ray_gets_out(kind: str, number: int) -> None:
    check_no_gap(building_mesh(kind, number))


def check_walkable(kind: str, number: int) -> None:
    """All points where one can stand can be walked to from the others."""
    scene = ss.load_scene(f"{kind}-{number}")
    assert not any("synthetic" in note or "matched by a word" in note for note in scene.notes)
    graph = ss.make_graph(scene, ss.make_grid(scene, config=ss.GridConfig(spacing=0.5, rays=60)))
    assert len(graph.nodes) > 3, scene.name
    within = graph.geodesic[np.ix_(graph.nodes, graph.nodes)]
    reached = np.isfinite(within).sum(axis=1)
    assert len(graph.nodes) == reached.max(), f"{scene.name}: {len(graph.nodes) - reached.max()} apart"


@pytest.mark.parametrize(
    "kind", [pytest.param(k, marks=CI_SLOW) if k in ("church", "hall") else k for k in KINDS]
)
def test_the_floor_is_one_piece(kind: str) -> None:
    check_walkable(kind, 1)


@pytest.mark.parametrize("name", sorted(furniture()))
def test_nobody_gets_stuck_in_a_piece(name: str) -> None:
    """Of any width, at any angle, in the middle of a room."""
    piece = furniture()[name]
    if piece.under or piece.high:
        return
    outline = np.array([(0, 0), (14, 0), (14, 9), (0, 9)], float)
    for k, width in enumerate(np.linspace(*piece.stretch, 5)):
        floor = Floor(Room("bedroom", outline, 0.0, 2.6, {}), [np.array([1.0, 1.0])], [])
        along = np.array([np.cos(0.17 * k), np.sin(0.17 * k)])
        floor.block([moved(s, np.array([4.0, 3.5]), along, 0.0) for s in piece.solids(width, {})])
        assert floor.walkway.is_open_with(), width


def test_no_rug_lies_over_a_hole() -> None:
    """Whoever could stand on it above a flight of stairs would be apart from all others."""
    floor = Floor(
        Room("stairwell", np.array([(0, 0), (6, 0), (6, 3), (0, 3)], float), 0.0, 2.6, {}), [], []
    )
    floor.holes += [np.array([(2, 1.9), (5, 1.9), (5, 2.9), (2, 2.9)], float)]
    rug, along = furniture()["rug"], np.array([1.0, 0.0])
    assert not floor.put(rug, np.array([2.5, 1.0]), along, 1.0)
    assert floor.put(rug, np.array([2.5, 0.3]), along, 1.0)


@pytest.mark.parametrize(
    ("near", "far", "free"), [(0.24, 0.24, False), (0.1, 0.1, True), (0.1, 0.35, True), (0.5, 0.5, True)]
)
def test_a_gap_is_a_trap_and_a_corner_is_not(near: float, far: float, free: bool) -> None:
    """Of a box at a wall, in a corner of the room, `near` m off at the closed end and `far` m 1.5 m further: parallel
    sides may be too narrow to tell whether one gets out, nobody stands between closer ones, and one walks out of
    those at an angle."""
    outline = np.array([(0, 0), (5, 0), (5, 4), (0, 4)], float)
    floor = Floor(Room("bedroom", outline, 0.0, 2.6, {}), [np.array([4.0, 2.0])], [])
    assert floor.walkway.is_open_with()
    a, b = floor.inner[0] + (0.0, near), floor.inner[0] + (1.5, far)
    assert floor.walkway.is_open_with([np.array([a, b, b + (0.0, 0.3), a + (0.0, 0.3)])]) == free


def inside(points: np.ndarray, solid: Solid) -> np.ndarray:
    """(n,) whether points (n, 3) lie 3 mm or more within an upright convex solid of level top and bottom."""
    a = solid.outline
    edge = np.roll(a, -1, axis=0) - a
    left = (
        edge[None, :, 0] * (points[:, None, 1] - a[:, 1])
        - edge[None, :, 1] * (points[:, None, 0] - a[:, 0])
    ) / np.linalg.norm(edge, axis=1)
    z = points[:, 2]
    return np.asarray(
        (left > 0.003).all(axis=1) & (z > solid.low.max() + 0.003) & (z < solid.high.min() - 0.003)
    )


def check_furniture_apart(kind: str, number: int) -> None:
    rng = np.random.default_rng((0xB01D, BUILDINGS[kind].number, BUILDINGS[kind].version, number))
    building = None
    while building is None:
        building = BUILDINGS[kind].make(rng)
    pieces = [s for s in building.solids if s.label.split("-")[0] not in SHELL]
    unit = np.random.default_rng(1).random((60, 3))
    boxes = np.array(
        [[*s.outline.min(axis=0), s.low.min(), *s.outline.max(axis=0), s.high.max()] for s in pieces]
    )
    for k, one in enumerate(pieces):
        near = (boxes[:, :3] < boxes[k, 3:]).all(axis=1) & (boxes[:, 3:] > boxes[k, :3]).all(axis=1)
        points = boxes[k, :3] + unit * (boxes[k, 3:] - boxes[k, :3])
        points = points[inside(points, one)]
        for j in np.flatnonzero(near):
            if j != k:
                shared = inside(points, pieces[j]).any()
                assert not shared, f"{kind}-{number}: {one.label} in {pieces[j].label} at {boxes[k]}"


@pytest.mark.parametrize(("kind", "number"), FEW)
def test_furniture_stands_apart(kind: str, number: int) -> None:
    check_furniture_apart(kind, number)


@pytest.mark.parametrize(("kind", "number"), [("home", 7), ("church", 7)])
def test_rooms_are_where_the_mesh_has_them(kind: str, number: int) -> None:
    """From a place inside a room's outline straight down is its floor, or what stands on it, and up its ceiling, or
    what hangs there."""
    mesh = building_mesh(kind, number)
    shape = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    rng = np.random.default_rng(0)
    for room in building_rooms(kind, number):
        points = rng.uniform(room.inner.min(axis=0), room.inner.max(axis=0), (200, 2))
        points = points[inside_polygon(points, room.inner)]
        top = room.height_at(points)
        middle = np.column_stack([points, 0.5 * (room.floor + top)])
        assert len(middle) > 20
        for sign, label in ((-1.0, "floor"), (1.0, "ceiling")):
            face = shape.ray.intersects_first(middle, np.tile([0.0, 0.0, sign], (len(middle), 1)))
            assert (face >= 0).all()
            z = mesh.vertices[mesh.faces[face]].mean(axis=1)[:, 2]
            limit = top if sign > 0.0 else np.full(len(top), room.floor)
            reached = np.array([mesh.labels[i].startswith(label) for i in mesh.face_label[face]])
            flat = reached & (room.profile is None or sign < 0.0)
            if room.kind != "stairwell":  # where there is a hole for the stairs
                assert reached.mean() > 0.2
                np.testing.assert_allclose(z[flat], limit[flat], atol=1e-3)


def test_case_furniture_absorbs_what_the_standard_says() -> None:
    """EN 12354-6, formula 4: V^(2/3) of a hard object; here over the surface that a piece at a wall shows."""
    cases = (
        "wardrobe",
        "chest",
        "nightstand",
        "sideboard",
        "small-kitchen",
        "refrigerator",
        "washer",
        "shoes",
    )
    table = own_materials()
    alpha = table.absorption[table.names.index("case-furniture")]
    stated = shown = 0.0
    for name in cases:
        boxes = [b for b in furniture()[name].boxes if b[0] not in ("basket", "vase", "lamp", "sink")]
        low, high = np.min([b[1:4] for b in boxes], axis=0), np.max([b[4:] for b in boxes], axis=0)
        x, y, z = high - low
        stated += (x * y * z) ** (2.0 / 3.0)
        shown += x * z + 2.0 * y * z + x * y
        np.testing.assert_allclose(
            alpha * (x * z + 2.0 * y * z + x * y), (x * y * z) ** (2.0 / 3.0), rtol=0.2
        )
    np.testing.assert_allclose(alpha * shown, stated, rtol=0.05)


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_forty_of_each_kind(kind: str) -> None:
    for number in range(10, 50):
        mesh = building_mesh(kind, number)
        check_closed_and_labelled(mesh)
        check_no_gap(mesh)
        check_furniture_apart(kind, number)
        if number < 25:
            check_walkable(kind, number)


def test_polygons_are_cut_into_triangles_of_the_same_area() -> None:
    outline = np.array([(0, 0), (4, 0), (4, 3), (3, 3), (3, 1), (1, 1), (1, 3), (0, 3)], float)
    found = np.array(triangles(outline))
    a, b, c = outline[found].transpose(1, 0, 2)
    twice = (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]
    assert len(found) == 6 and (twice > 0.0).all() and 0.5 * twice.sum() == pytest.approx(8.0)
    np.testing.assert_allclose(
        inset(np.array([(0, 0), (4, 0), (4, 3), (0, 3)], float), 0.5)[2], [3.5, 2.5]
    )
