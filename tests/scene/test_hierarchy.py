"""Rays without Embree: plane geometry, brute force, Embree, edges that let nothing through, and who casts them."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import soundspaces_sim as ss
from soundspaces_sim.core import embree_library
from soundspaces_sim.core.numerics import target
from soundspaces_sim.core.numerics.kernel import kernel
from soundspaces_sim.scene.rays import embree, hierarchy
from tests.marks import ci_slow
from tests.rooms import box, table

ROOT = Path(__file__).resolve().parents[2]


@kernel
def _cast(handle, o, d, limit, t, face, hit):  # type: ignore[no-untyped-def]
    for i in range(len(o)):
        p, e = (o[i, 0], o[i, 1], o[i, 2]), (d[i, 0], d[i, 1], d[i, 2])
        t[i], face[i] = hierarchy.intersect(handle, p, e, limit)
        hit[i] = hierarchy.occluded(handle, p, e, limit)


@kernel
def _cast_by_embree(handle, o, d, limit, t, face, hit):  # type: ignore[no-untyped-def]
    for i in range(len(o)):
        p, e = (o[i, 0], o[i, 1], o[i, 2]), (d[i, 0], d[i, 1], d[i, 2])
        t[i], face[i] = embree.intersect(handle, p, e, limit)
        hit[i] = embree.occluded(handle, p, e, limit)


def _hits(
    vertices: np.ndarray, faces: np.ndarray, o: np.ndarray, d: np.ndarray, limit: float = np.inf,
    cast: Any = _cast,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:  # fmt: skip
    rays: Any = (hierarchy if cast is _cast else embree).RayScene(vertices, faces)
    out = np.empty(len(o)), np.empty(len(o), np.int64), np.empty(len(o), bool)
    cast(rays.handle, np.ascontiguousarray(o, float), np.ascontiguousarray(d, float), limit, *out)
    return out


def _directions(rng: np.random.Generator, count: int) -> np.ndarray:
    d = rng.normal(size=(count, 3))
    return np.asarray(d / np.linalg.norm(d, axis=1, keepdims=True))


def _brute(
    corners: np.ndarray, o: np.ndarray, d: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Distances, triangles, and whether edges are far, by Möller and Trumbore's formula for all triangles."""
    a, e1, e2 = corners[:, 0], corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    p = np.cross(d[:, None], e2[None])
    det = np.einsum("fk,rfk->rf", e1, p)
    s = o[:, None] - a[None]
    u = np.einsum("rfk,rfk->rf", s, p) / det
    q = np.cross(s, e1[None])
    v = np.einsum("rk,rfk->rf", d, q) / det
    t = np.einsum("fk,rfk->rf", e2, q) / det
    inside = np.minimum(np.minimum(u, v), 1.0 - u - v)
    t = np.where((inside >= 0.0) & (t >= 0.0), t, np.inf)
    face = t.argmin(axis=1)
    best = t[np.arange(len(o)), face]
    return best, np.where(np.isfinite(best), face, -1), np.abs(inside).min(axis=1) > 1e-9


def test_distances_to_the_walls_of_a_box() -> None:
    scene = box((6.0, 5.0, 2.7), table(0.1, 0.1))
    rng = np.random.default_rng(0)
    o = rng.uniform([0.1, 0.1, 0.1], [5.9, 4.9, 2.6], (500, 3))
    d = _directions(rng, 500)
    d[:6] = np.concatenate([np.eye(3), -np.eye(3)])  # along axes, too
    with np.errstate(divide="ignore", invalid="ignore"):
        walls = np.where(d > 0.0, (np.array([6.0, 5.0, 2.7]) - o) / d, np.where(d < 0.0, -o / d, np.inf))
    t, face, hit = _hits(scene.vertices, scene.faces, o, d)
    np.testing.assert_allclose(t, walls.min(axis=1), rtol=1e-12)
    np.testing.assert_array_equal(face // 4, walls.argmin(axis=1))
    assert hit.all()
    for k in range(50):
        near = _hits(scene.vertices, scene.faces, o[k : k + 1], d[k : k + 1], 0.9 * walls[k].min())
        assert near[0][0] == np.inf and near[1][0] == -1 and not near[2][0]


@pytest.mark.parametrize("count", [1, 4, 5, 300])
def test_brute_force_finds_the_same(count: int) -> None:
    rng = np.random.default_rng(count)
    vertices = rng.normal(size=(3 * count, 3))
    faces = np.arange(3 * count).reshape(count, 3)
    o, d = rng.normal(size=(4000, 3)), _directions(rng, 4000)
    t, face, hit = _hits(vertices, faces, o, d)
    wanted, triangle, clear = _brute(vertices[faces], o, d)
    assert clear.mean() > 0.99
    np.testing.assert_array_equal(face[clear], triangle[clear])
    np.testing.assert_allclose(t[clear], wanted[clear], rtol=1e-9)
    np.testing.assert_array_equal(hit[clear], triangle[clear] >= 0)
    assert (face >= 0).sum() > 0


def test_embree_meets_the_same_triangles() -> None:
    """In a furnished home. Where triangles lie in one place either may take another, and Embree rounds to single
    precision, so that rays near an edge may meet the neighbour: both at the same distance to 10 micrometres."""
    scene = ss.load_scene("demo")
    vertices = scene.vertices - scene.center
    rng = np.random.default_rng(0)
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    o, d = rng.uniform(low, high, (20000, 3)), _directions(rng, 20000)
    own, others = (_hits(vertices, scene.faces, o, d, cast=cast) for cast in (_cast, _cast_by_embree))
    same = own[1] == others[1]
    met = (own[1] >= 0) & (others[1] >= 0)
    assert same.mean() > 0.97 and (same | met).mean() > 0.9998
    off = np.abs(own[0][met] - others[0][met]) / np.maximum(1.0, own[0][met])
    assert (off <= 1e-5).mean() > 0.9998
    assert (own[2] == others[2]).mean() > 0.9998 and own[2].mean() > 0.5


def test_no_ray_passes_between_triangles() -> None:
    """A sphere of triangles with corners at random: from inside, rays through edges and corners exactly, computed in
    the same numbers, meet one of the triangles that share them; rays past a lone edge are free to miss."""
    from scipy.spatial import ConvexHull

    rng = np.random.default_rng(2)
    points = _directions(rng, 400)
    faces = ConvexHull(points).simplices
    corners = points[faces]
    ends = [corners[:, k] for k in range(3)]
    middles = [0.5 * (corners[:, k] + corners[:, k - 1]) for k in range(3)]
    share = rng.uniform(size=(len(corners), 1))
    along = [share * corners[:, k] + (1.0 - share) * corners[:, k - 1] for k in range(3)]
    d = np.concatenate([*ends, *middles, *along])
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    for o in (np.zeros(3), np.array([0.1, -0.2, 0.3]), np.array([0.0, 0.5, 0.0])):
        aim = np.concatenate([*ends, *middles, *along]) - o
        aim /= np.linalg.norm(aim, axis=1, keepdims=True)
        t, face, hit = _hits(points, faces, np.broadcast_to(o, aim.shape), aim)
        assert (face >= 0).all() and hit.all() and (t > 0.1).all()


def test_a_grid_seen_along_its_axes_has_no_holes() -> None:
    """Rays in the planes of edges, at corners, along an axis: directions with zeros."""
    n = np.arange(9.0)
    x, y = (a.ravel() for a in np.meshgrid(n, n))
    vertices = np.stack([x, y, np.zeros(81)], axis=1)
    k = (np.arange(8)[:, None] * 9 + np.arange(8)).ravel()
    faces = np.concatenate([np.stack([k, k + 1, k + 10], 1), np.stack([k, k + 10, k + 9], 1)])
    inner = vertices[(x > 0) & (x < 8) & (y > 0) & (y < 8)]
    for down in (1.0, -1.0):
        o = inner + [0.0, 0.0, down]
        t, face, hit = _hits(vertices, faces, o, np.broadcast_to([0.0, 0.0, -down], o.shape))
        assert (t == 1.0).all() and hit.all() and (face >= 0).all()


def test_of_triangles_in_one_place_the_first_is_met() -> None:
    """Whatever the order of the leaves."""
    one = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])
    rng = np.random.default_rng(0)
    other = rng.normal(size=(60, 3)) + [0.0, 0.0, -5.0]
    vertices = np.concatenate([other, one, one, one])
    faces = np.arange(69).reshape(23, 3)
    for order in (np.arange(23), np.arange(23)[::-1], rng.permutation(23)):
        _, face, _ = _hits(vertices, faces[order], np.array([[0.2, 0.3, 1.0]]), np.array([[0.0, 0, -1]]))
        assert face[0] == min(int(np.flatnonzero(order == f)[0]) for f in (20, 21, 22))


def test_what_is_no_mesh_is_refused() -> None:
    with pytest.raises(ss.SceneError, match="got 0 triangles"):
        hierarchy.RayScene(np.zeros((0, 3)), np.zeros((0, 3), int))
    with pytest.raises(ss.SceneError, match="finite corners"):
        hierarchy.RayScene(np.full((3, 3), np.nan), np.array([[0, 1, 2]]))


def test_triangles_without_area_and_many_in_one_place() -> None:
    vertices = np.repeat(np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]), 40, axis=0).reshape(3, 40, 3)
    flat = np.concatenate([vertices.transpose(1, 0, 2).reshape(-1, 3), np.ones((30, 3))])
    faces = np.arange(len(flat)).reshape(-1, 3)
    t, face, _ = _hits(flat, faces, np.array([[0.1, 0.1, 2.0]]), np.array([[0.0, 0, -1]]))
    assert t[0] == 2.0 and face[0] == 0


# Who casts rays


def _engine(monkeypatch: pytest.MonkeyPatch, choice: str | None, found: str | None) -> str:
    monkeypatch.delenv(embree_library.VARIABLE, raising=False)
    if choice is None:
        monkeypatch.delenv(embree_library.CHOICE, raising=False)
    else:
        monkeypatch.setenv(embree_library.CHOICE, choice)
    monkeypatch.setattr(embree_library, "_of_embreex", lambda: found)
    monkeypatch.setattr(embree_library, "find_library", lambda _: None)
    return str(embree_library.ray_engine.__wrapped__())


def test_embree_goes_before_and_arrays_stand_in(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    assert _engine(monkeypatch, None, "a.so") == "embree"
    assert _engine(monkeypatch, "arrays", "a.so") == "arrays"
    assert _engine(monkeypatch, "embree", None) == "embree"  # and loading it says what is missing
    assert not caplog.records
    assert _engine(monkeypatch, None, None) == "arrays"
    assert "no Embree 4 here: rays are cast by arrays" in caplog.text
    with pytest.raises(ss.SceneError, match="SOUNDSPACES_SIM_RAYS: expected auto, embree or arrays"):
        _engine(monkeypatch, "optix", None)


def test_keys_hold_who_casts(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(target, "ray_engine", lambda: "embree")
    plain = target.code_target.__wrapped__()
    monkeypatch.setattr(target, "ray_engine", lambda: "arrays")
    assert target.code_target.__wrapped__() == f"{plain} rays-by-arrays"


@ci_slow  # compiles all kernels anew
def test_a_simulation_without_embree() -> None:
    """In a process of its own: no library of Embree is loaded, and energies are those of Embree's simulation, to
    what differs by rays near edges."""
    code = (
        "import sys, numpy as np, soundspaces_sim as ss\n"
        "scene = ss.shoebox((5.0, 4.0, 3.0), absorption=0.2, scattering=0.3)\n"
        "few = ss.SimulationConfig(walks=64, duration=0.2,"
        " radiance_transfer=ss.RadianceTransferConfig(enabled=False))\n"
        "e = ss.simulate(scene, [[1.0, 1.2, 1.1]], [[3.9, 2.1, 1.6]], few)[0, 0]\n"
        "loaded = open('/proc/self/maps').read() if sys.platform == 'linux' else ''\n"
        "print(e.energy[:, 0].sum(), len(e.early), 'embree' in loaded)\n"
    )
    found = []
    for choice in ("arrays", "embree"):
        environment = {**os.environ, embree_library.CHOICE: choice}
        done = subprocess.run(
            [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, env=environment
        )
        assert done.returncode == 0, done.stderr[-2000:]
        found.append(done.stdout.split())
    (energy, early, loaded), (wanted, all_early, _) = found
    assert float(energy) == pytest.approx(float(wanted), rel=0.02) and early == all_early
    assert loaded == "False"
