"""Sheets that hang free: which faces are, and what a pass does."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import soundspaces_sim as ss
from soundspaces_sim.build.plan import job_key
from soundspaces_sim.core.config import JobConfig, SimulationConfig
from soundspaces_sim.scene.materials import load_materials, pass_absorption, porous_share
from soundspaces_sim.scene.porous_layers import mounted, with_free_sheets
from soundspaces_sim.scene.scene import scene_key
from soundspaces_sim.transport.scene_surfaces import scene_surfaces
from tests.rooms import box, plain, plane, table
from tests.transport.test_find_wedges import _cuboid

TABLE = load_materials()
CURTAIN, DEFAULT = TABLE.index("curtain"), TABLE.index("default")


def _room(vertices: np.ndarray, faces: np.ndarray) -> ss.Scene:
    """A mesh of curtain in a room of 6 x 5 x 3 m."""
    room = box((6.0, 5.0, 3.0), TABLE, DEFAULT)
    return ss.Scene(
        np.concatenate([room.vertices, vertices]),
        np.concatenate([room.faces, faces + len(room.vertices)]),
        np.concatenate([room.face_material, np.full(len(faces), CURTAIN)]),
        TABLE,
        name="room",
    )


def _rectangle(x: float, folds: int = 1, depth: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """A curtain at `x`, 2 m wide and high, in `folds` strips that swing by `depth`."""
    y = np.linspace(1.0, 3.0, folds + 1)
    x_ = x + depth * (np.arange(folds + 1) % 2)
    v = np.concatenate([np.stack([x_, y, np.full(folds + 1, z)], axis=1) for z in (0.2, 2.2)])
    n = folds + 1
    faces = [[i, i + 1, n + i + 1] for i in range(folds)] + [[i, n + i + 1, n + i] for i in range(folds)]
    return v, np.array(faces)


def _free(scene: ss.Scene) -> np.ndarray:
    marked = with_free_sheets(scene)
    return np.flatnonzero(
        np.char.endswith([marked.materials.names[m] for m in marked.face_material], "(free-hanging)")
    )


@pytest.mark.parametrize(
    ("curtain", "free"),
    [
        (_rectangle(3.0), True),  # in mid-air
        (_rectangle(3.0, 20, 0.1), True),  # in folds
        (_rectangle(0.15), True),  # a hand's breadth before a wall: it is passed twice
        (_rectangle(0.01), False),  # at the wall
        (_cuboid([2.0, 2.0, 0.0], [4.0, 2.9, 0.8]), False),  # a sofa
        (_cuboid([2.0, 2.0, 1.0], [4.0, 2.9, 1.8], 4), False),  # a cushion in mid-air
    ],
)
def test_what_hangs_free(curtain: tuple[np.ndarray, np.ndarray], free: bool) -> None:
    scene = _room(*curtain)
    np.testing.assert_array_equal(_free(scene), np.arange(12, len(scene.faces)) if free else [])


def test_a_sofa_without_a_bottom_is_a_body() -> None:
    """Furniture is often a shell that is open towards the floor on which it stands."""
    vertices, faces = _cuboid([2.0, 2.0, 0.0], [4.0, 2.9, 0.8])
    faces = faces[vertices[faces][:, :, 2].max(axis=1) > 0.1]
    assert len(faces) == 10 and len(_free(_room(vertices, faces))) == 0


def test_each_piece_by_itself() -> None:
    """A sofa and a curtain of the same material in one room; the note names what was taken as a sheet."""
    v, f = _cuboid([2.0, 2.0, 0.0], [4.0, 2.9, 0.8])
    w, g = _rectangle(5.0)
    scene = _room(np.concatenate([v, w]), np.concatenate([f, g + len(v)]))
    marked = with_free_sheets(scene)
    np.testing.assert_array_equal(_free(scene), [24, 25])
    assert marked.notes[-1].startswith("2 faces (4.0 m2) of curtain hang free")
    np.testing.assert_array_equal(mounted(marked).face_material, scene.face_material)
    assert with_free_sheets(mounted(marked)).digest == marked.digest


def test_a_pass_takes_half_in_decibels() -> None:
    """Two passes take alpha; the porous sheet's share: r = 4 alpha / (2 + r)² and 4 / (2 + r)² in closed form."""
    alpha = np.array([0.0, 0.07, 0.31, 0.6, 0.75])
    a = pass_absorption(alpha)
    np.testing.assert_allclose((1.0 - a) ** 2, 1.0 - alpha)
    resistance = np.array([0.0, 0.1, 0.5, 1.0, 2.0])
    np.testing.assert_allclose(
        porous_share(4.0 * resistance / (2.0 + resistance) ** 2), 4.0 / (4.0 + resistance**2), rtol=1e-6
    )
    marked = with_free_sheets(_room(*_rectangle(3.0)))
    row = int(marked.face_material[-1])
    np.testing.assert_allclose(
        marked.materials.absorption[row], pass_absorption(TABLE.absorption[CURTAIN])
    )
    # before a rigid wall, all orders of reflection between the two: the tabulated absorption again
    reflected = 1.0 - marked.materials.absorption[row] - marked.materials.transmission[row]
    back = reflected + marked.materials.transmission[row] ** 2 / (1.0 - reflected)
    np.testing.assert_allclose(1.0 - back, TABLE.absorption[CURTAIN], atol=0.1)


def test_direct_sound_passes_a_free_curtain() -> None:
    """By the share in the table; with sheets off, by the table's own transmission."""
    scene = with_free_sheets(_room(*_rectangle(3.0)))
    ends = [[2.0, 2.0, 1.2]], [[4.0, 2.0, 1.2]]
    config = plain(walks=16, connections={"subpaths": 0}, duration=0.05)
    rows = scene.materials.in_bands(config.bands)[2]
    for on, row in ((True, int(scene.face_material[-1])), (False, CURTAIN)):
        e = ss.simulate(
            scene, *ends, plain(walks=16, connections={"subpaths": 0}, duration=0.05, porous_layers=on)
        )[0, 0]
        assert e.direct is not None
        np.testing.assert_allclose(e.direct.energy * 16.0 * np.pi, rows[row], rtol=1e-6)


def test_loaders_mark_and_report_them(tmp_path: Path) -> None:
    """An OBJ file with a curtain in mid-air, and a material file that says how much passes."""
    scene = _room(*_rectangle(3.0))
    lines = [f"v {x} {y} {z}" for x, y, z in scene.vertices]
    for i, (a, b, c) in enumerate(scene.faces + 1):
        lines += ["usemtl wall" if i == 0 else "usemtl net"] if i in (0, 12) else []
        lines.append(f"f {a} {b} {c}")
    (tmp_path / "room.obj").write_text("\n".join(lines))
    (tmp_path / "own.toml").write_text(
        "frequency_hz = [1000]\n[materials.net]\nabsorption = [0.36]\nscattering = [0.2]\ntransmission = [0.0]\n"
        "sheet = 0.5\n[labels]\nnet = 'net'\n"
    )
    own = str(tmp_path / "own.toml")
    loaded = ss.load_scene(tmp_path / "room.obj", up="z", unit="m", materials=own, labels=own)
    assert any("2 faces (4.0 m2) of net (net) hang free" in note for note in loaded.notes)
    row = loaded.materials.index("net (free-hanging)")
    assert (loaded.face_material == row).sum() == 2
    np.testing.assert_allclose(loaded.materials.absorption[row], 0.2)
    np.testing.assert_allclose(loaded.materials.transmission[row], 0.4)


def test_a_share_out_of_range_is_refused() -> None:
    shares = np.full_like(TABLE.absorption, 1.5)
    with pytest.raises(ss.MaterialError, match="sheet"):
        replace(TABLE, sheet=shares)


def _keys(scene: ss.Scene) -> tuple[str, str, tuple[object, ...]]:
    """Of the scene, of a job in it, and of what is kept of it between processes."""
    return scene.digest, job_key(scene.digest, JobConfig(), 1.0, np.zeros((1, 3))), scene_key(scene)


def test_what_hangs_free_is_part_of_what_a_scene_is() -> None:
    """The same coefficients follow the law of a sheet or that of a wall: scenes that differ in that alone."""
    wall = table(0.3, 0.0, 0.4)
    scenes = [plane(1.0, m) for m in (wall, replace(wall, mounting=("free",)))]
    config = SimulationConfig(reflection="angle")
    of_wall, of_sheet = (scene_surfaces(s, config, np.empty((2, 0)))[0].parameters for s in scenes)
    assert not np.allclose(of_wall, of_sheet)
    for one, other in zip(*map(_keys, scenes), strict=True):
        assert one != other


def test_what_a_sheet_is_when_mounted_is_part_of_what_a_scene_is() -> None:
    """`sheets = false` takes a free-hanging sheet as the material of the same name: as `a` here, or as `b`."""
    own, mounting = table([0.1, 0.6, 0.3], 0.2), ("wall", "wall", "free")
    scenes = [
        box(
            (4.0, 3.0, 2.5),
            replace(own, names=("a", "b", f"{name} (free-hanging)"), mounting=mounting),
            2,
        )
        for name in "ab"
    ]
    assert [int(mounted(scene).face_material[0]) for scene in scenes] == [0, 1]
    for one, other in zip(*map(_keys, scenes), strict=True):
        assert one != other


def test_mounting_is_told_by_the_table_and_by_names_where_it_is_silent() -> None:
    """Tables of earlier versions tell it by the suffix of a name alone."""
    own = table([0.1, 0.1, 0.1], 0.2)
    silent = ss.MaterialTable(
        ("a", "b (free-hanging)", "c"),
        own.frequency_hz,
        own.absorption,
        own.scattering,
        own.transmission,
    )
    assert silent.mounting == ("wall", "free", "wall")
    assert replace(silent, mounting=("free", "wall", "wall")).free_hanging.tolist() == [
        True,
        False,
        False,
    ]
    assert replace(silent, mounting=("wall",) * 3).content() != silent.content()
    with pytest.raises(
        ss.MaterialError, match="mounting of 'c' must be 'wall' or 'free', got 'ceiling'"
    ):
        replace(silent, mounting=("wall", "free", "ceiling"))


def test_a_sheet_without_its_material_cannot_be_mounted() -> None:
    scene = plane(1.0, replace(table(0.3, 0.0), names=("cloth (free-hanging)",), mounting=("free",)))
    with pytest.raises(ss.MaterialError, match=r"plane.*'cloth \(free-hanging\)'.*no 'cloth'"):
        mounted(scene)


def test_scenes_without_sheets_keep_their_digest() -> None:
    """That of version 0.1.0: datasets and jobs in such scenes go on. Names alone change nothing."""
    scene = plane(1.0, table(0.3, 0.25, 0.4))
    assert scene.digest == "4efd5f5c74e60ede547e2eef7078fa4da2d9c01a1f76b3df041f4718e40355af"
    assert replace(scene, materials=replace(scene.materials, names=("wall",))).digest == scene.digest
