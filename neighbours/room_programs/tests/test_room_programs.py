"""Models of CATT-Acoustic and ODEON: a shoebox written in them is the one that `build.shoebox` makes."""

from pathlib import Path

import numpy as np
import pytest

import soundspaces_sim as ss
from soundspaces_sim.core.errors import SceneError
from soundspaces_sim.scene.build import WALLS, shoebox
from soundspaces_sim.scene.scene import Scene

SIZE = (7.0, 5.0, 3.0)
ABSORPTION = {"west": 0.1, "east": 0.2, "south": 0.3, "north": 0.4, "floor": 0.05, "ceiling": 0.6}
CORNERS = [(x, y, z) for x in (0.0, 7.0) for y in (0.0, 5.0) for z in (0.0, 3.0)]
#: Corners of each wall, counter-clockwise as seen from within; numbers from 1 on.
QUADS = {
    "west": (1, 3, 4, 2), "east": (5, 6, 8, 7), "south": (1, 2, 6, 5), "north": (3, 7, 8, 4), "floor": (1, 5, 7, 3),
    "ceiling": (2, 4, 8, 6),
}  # fmt: skip


def catt(path: Path, planes: str = "", head: str = "") -> Path:
    rows = [";made by hand", head]
    rows += [
        f"ABS {w} = <{100 * a:g} {100 * a:g} {100 * a:g} {100 * a:g}> L <30> {{1 2 3}}"
        for w, a in ABSORPTION.items()
    ]
    rows += [
        "CORNERS",
        *(f"{i} {x} {y} {z} ; comment" for i, (x, y, z) in enumerate(CORNERS, 1)),
        "PLANES",
    ]
    rows += [f"[{i} {w} / {' '.join(map(str, QUADS[w]))} / {w}]" for i, w in enumerate(WALLS, 1)]
    path.write_text("\n".join(rows) + planes)
    return path


def odeon(path: Path, unit: float = 1.0, head: str = "") -> Path:
    rows = ["a hall: this is not read", "###", head]
    rows += [f"Pt {i} {x * unit} {y * unit} {z * unit}" for i, (x, y, z) in enumerate(CORNERS, 1)]
    for i, w in enumerate(WALLS, 1):
        rows += [f"Surf {i} {w}", " ".join(map(str, QUADS[w])) + " : comment"]
    path.write_text("\n".join([*rows, "###", "For ever"]))
    return path


def gmsh(path: Path, extra: str = "", surfaces: bool = True) -> Path:
    """The room of `test_room_programs`, as Gmsh has it: each edge once, loops of signed edges."""
    rows = ["// made by hand", "/* two", 'lines */ SetFactory("OpenCASCADE");']
    rows += [f"Point({i}) = {{ {x}, {y}, {z}, 1.0 }};" for i, (x, y, z) in enumerate(CORNERS, 1)]
    edges: dict[tuple[int, int], int] = {}
    loops = []
    for name in WALLS:
        quad, loop = QUADS[name], []
        for a, b in zip(quad, (*quad[1:], quad[0]), strict=True):
            if (b, a) in edges:
                loop.append(-edges[b, a])
            else:
                loop.append(edges.setdefault((a, b), len(edges) + 1))
        loops.append(loop)
    assert len(edges) == 12
    rows += [f"Line({n}) = {{ {a}, {b} }};" for (a, b), n in edges.items()]
    for i, (name, loop) in enumerate(zip(WALLS, loops, strict=True), 1):
        kind = "Curve Loop" if i % 2 else "Line Loop"
        rows += [f"{kind}({i}) = {{ {', '.join(map(str, loop))} }};", f"Plane Surface({i}) = {{ {i} }};"]
        if surfaces:
            rows.append(f'Physical Surface("{name}", {100 + i}) = {{ {i} }};')
    rows += ["Surface Loop(1) = { 1, 2, 3, 4, 5, 6 };", "Volume(1) = { 1 };", "Mesh.Algorithm = 6;"]
    rows += ['Physical Volume("Room") = { 1 };', 'Physical Line("default") = { 1, 2 };']
    path.write_text("\n".join([*rows, extra]) + "\n")
    return path


def same_room(scene: Scene, expected: Scene) -> None:
    """The same faces in any order: each wall's area, place and coefficients in bands."""
    bands = (63.0, 125.0, 500.0, 2000.0, 8000.0)
    for name in WALLS:
        row = scene.labels.index(name)
        own, wall = scene.face_label == row, np.repeat([w == name for w in WALLS], 2)
        np.testing.assert_array_equal(
            np.unique(scene.corners[own].reshape(-1, 3), axis=0),
            np.unique(expected.corners[wall].reshape(-1, 3), axis=0),
        )
        for ours, theirs in zip(
            scene.materials.in_bands(bands), expected.materials.in_bands(bands), strict=True
        ):
            np.testing.assert_allclose(
                ours[scene.face_material[own]], theirs[expected.face_material[wall]], atol=1e-12
            )
    assert len(scene.faces) == 12


def test_a_shoebox_of_catt_is_the_shoebox(tmp_path: Path) -> None:
    scene = ss.load_scene(catt(tmp_path / "box.geo"))
    same_room(scene, shoebox(SIZE, ABSORPTION, 0.3))
    soft = ss.load_scene(catt(tmp_path / "box.geo"), labels={"floor": "carpet"})
    floor = soft.face_label == soft.labels.index("floor")
    assert {soft.materials.names[m] for m in soft.face_material[floor]} == {"carpet"}


def test_a_shoebox_of_odeon_is_the_shoebox(tmp_path: Path) -> None:
    """Its surfaces' names are labels; absorption comes from the user, as ODEON has it in another file."""
    room = shoebox(SIZE, ABSORPTION)
    table = room.materials
    of_wall = {wall: table.names[room.face_material[2 * i]] for i, wall in enumerate(WALLS)}
    for unit, head in ((1.0, ""), (1000.0, "Unit Millimetres\nBeginBlock\nEndBlock")):
        scene = ss.load_scene(odeon(tmp_path / "box.par", unit, head), materials=table, labels=of_wall)
        same_room(scene, shoebox(SIZE, ABSORPTION))


def test_planes_may_be_concave_run_over_lines_and_name_ranges(tmp_path: Path) -> None:
    """An L-shaped floor of 5 m²: its triangles add up to it."""
    path = tmp_path / "l.geo"
    plan = [(0, 0), (3, 0), (3, 1), (1, 1), (1, 3), (0, 3)]
    rows = ["CORNERS", *(f"{10 + i} {x} {y} 0" for i, (x, y) in enumerate(plan)), "PLANES"]
    rows += ["[1 floor", " / 10-15", " / felt* ] [2 back \\15-10\\ felt]"]
    path.write_text("\n".join(rows))
    scene = ss.load_scene(path, ceiling=False)
    area = 0.5 * np.linalg.norm(
        np.cross(scene.corners[:, 1] - scene.corners[:, 0], scene.corners[:, 2] - scene.corners[:, 0]),
        axis=1,
    )
    assert area.sum() == pytest.approx(5.0)  # front and back are one
    assert scene.labels == ("felt",)


def test_half_a_model_of_odeon_is_mirrored(tmp_path: Path) -> None:
    """Corners and surfaces with negative numbers are those at -y."""
    path = tmp_path / "half.par"
    path.write_text(
        "Pt 1 0 2 0\nPt 2 4 2 0\nPt 3 4 2 3\nPt 4 0 2 3\nSurf -1 side\n1 2 3 4\nSurf 2 floor\n1 2 -2 -1\n"
    )
    scene = ss.load_scene(path, ceiling=False)
    np.testing.assert_allclose(scene.bounds, [[0, -2, 0], [4, 2, 3]])
    side = scene.corners[scene.face_label == scene.labels.index("side")]
    assert sorted(np.unique(side[..., 1]).tolist()) == [-2.0, 2.0]
    assert any("negative numbers are taken as mirrored" in note for note in scene.notes)


@pytest.mark.parametrize(
    ("planes", "head", "message"),
    [
        ("", "INCLUDE other.geo", "line 2: 'INCLUDE other.geo' is not understood"),
        ("", "LOCAL h = 3", "TUCT"),
        ("", "ABS odd = <10 x>", "percent"),
        ("", "ABS odd = <10 200>", "line 2"),
        ("", "ABS odd = 10", "expected ABS"),
        ("\n[9 x / 1 2 99 / floor]", "", "no point 99"),
        ("\n[9 x / 1-999999999 / floor]", "", "256"),
        ("\n[9 x / 1 2 (3) / floor]", "", "corners / material"),
        ("\n[9 x / 1 2 3 / floor", "", "does not end"),
        ("\nMIRROR", "", "MIRROR"),
        ("\n[9 x / 1 2 / floor]", "", "3 to 256"),
    ],
)
def test_what_catt_would_compute_is_refused(
    tmp_path: Path, planes: str, head: str, message: str
) -> None:
    with pytest.raises(SceneError, match=message):
        ss.load_scene(catt(tmp_path / "odd.geo", planes, head))


@pytest.mark.parametrize(
    ("head", "message"),
    [
        ("Const h 3", "line 3: 'Const h 3' is not understood"),
        ("Unit furlongs", "furlongs"),
        ("Pt 1 0 0", "not understood"),
        ("Surf 1 a\n1 2 x", "numbers of corners"),
        ("Surf 1 a\n1 2 77", "no point 77"),
        ("Pt 1 1e999 0 0", "finite"),
    ],
)
def test_what_odeon_would_compute_is_refused(tmp_path: Path, head: str, message: str) -> None:
    path = odeon(tmp_path / "odd.par", 1.0, head)
    if message == "finite":
        path.write_text(path.read_text().replace("Pt 1 0.0 0.0 0.0\n", ""))
    with pytest.raises(SceneError, match=message):
        ss.load_scene(path)


def test_a_small_file_costs_little(tmp_path: Path) -> None:
    """Ranges would let a few bytes ask for many corners; a plane that never ends is noticed early; text is text."""
    path = tmp_path / "many.geo"
    ring = [(np.cos(t), np.sin(t)) for t in np.linspace(0, 2 * np.pi, 256, endpoint=False)]
    rows = [
        "CORNERS",
        *(f"{i} {x:.6f} {y:.6f} 0" for i, (x, y) in enumerate(ring)),
        "PLANES",
        *["[1 a/0-255/b]"] * 200,
    ]
    path.write_text("\n".join(rows))
    with pytest.raises(SceneError, match="more corners than"):
        ss.load_scene(path)
    path.write_text("PLANES\n[" + "x\n" * 20_000)
    with pytest.raises(SceneError, match="does not end"):
        ss.load_scene(path)
    path.write_bytes(b"PLANES\n\0")
    with pytest.raises(SceneError, match="zero bytes"):
        ss.load_scene(path)


def test_far_corners_are_told(tmp_path: Path) -> None:
    path = catt(tmp_path / "box.geo")
    path.write_text(path.read_text().replace("8 7.0", "8 1e300"))
    with pytest.raises(SceneError, match=r"box\.geo: some points have coordinates.*beyond 1e\+12"):
        ss.load_scene(path)


def test_ranges_of_corners_are_bounded_as_they_are_read(tmp_path: Path) -> None:
    path = catt(tmp_path / "box.geo", "\n[9 a / " + "1-200 " * 10**5 + "/ west]")
    with pytest.raises(SceneError, match="at most 256 corners"):
        ss.load_scene(path)


def test_a_room_of_gmsh_is_the_shoebox(tmp_path: Path) -> None:
    room = shoebox(SIZE, ABSORPTION)
    table = room.materials
    of_wall = {wall: table.names[room.face_material[2 * i]] for i, wall in enumerate(WALLS)}
    scene = ss.load_scene(gmsh(tmp_path / "room.geo"), materials=table, labels=of_wall)
    same_room(scene, room)


@pytest.mark.parametrize(
    ("extra", "message"),
    [
        ("h = 3;", "line 47: 'h = 3' is not understood"),
        ("Extrude {0, 0, 1} { Surface{1}; }", "not understood"),
        ("Plane Surface(7) = { 1, 2 };", "holes"),
        ("Plane Surface(7) = { 9 };", "no loop 9"),
        ("Line Loop(9) = { 1, 2, 99 }; Plane Surface(7) = { 9 };", "no line 99"),
        ("Line Loop(9) = { 1, 3, 2 }; Plane Surface(7) = { 9 };", "end to end"),
        ("Line(99) = { 1, 77 }; Line(98) = { 77, 1 }; Line Loop(9) = { 99, 98, 1, -1 };"
         "Plane Surface(7) = { 9 };", "no point 77"),
        ('Physical Surface("x") = { 77 };', "no surface 77"),
        ("Point(9) = { 1, 2, x };", "x, y and z"),
        ("Point(9) = { 1, 2, 3 }", "semicolon"),
        ("/* a " * 200_000, "line 47: this comment does not end"),
        ("/*/", "this comment does not end"),
        ("Point(9) = { 1e300, 2, 3 };", "beyond"),
        ("Line Loop(9) = {" + "1, -1, " * 100 + "1, -1};" + "".join(f"Plane Surface({i}) = {{ 9 }};" for i in range(9, 99)), "more corners"),
    ],
)  # fmt: skip
def test_what_gmsh_would_compute_is_refused(tmp_path: Path, extra: str, message: str) -> None:
    with pytest.raises(SceneError, match=message):
        ss.load_scene(gmsh(tmp_path / "odd.geo", extra))
