"""Scattering by size: Fresnel's formula adds up, ends are found, and a piece's mean is that of the paths over it."""

from itertools import pairwise

import numpy as np
import pytest
from scipy.special import fresnel

import soundspaces_sim as ss
from soundspaces_sim.core.numerics.bands import DEFAULT_BANDS, log_edges
from soundspaces_sim.transport.bsdf import finite_size as finite
from soundspaces_sim.transport.bsdf.finite_size import kept_in_beam, size_scattering
from soundspaces_sim.transport.scene_surfaces import scattered_by_size, scene_surfaces
from tests.marks import few
from tests.rooms import box, plain, sphere, table, two_rooms
from tests.transport.test_find_wedges import _cuboid

C = 343.0
ROOM = np.array([6.0, 5.0, 3.0])


def _in_room(*parts: tuple[np.ndarray, np.ndarray]) -> ss.Scene:
    """Meshes in a room; the room's are the first twelve faces."""
    room = box((6.0, 5.0, 3.0), table(0.2, 0.1))
    vertices, faces = [room.vertices], [room.faces]
    for v, f in parts:
        faces.append(f + sum(map(len, vertices)))
        vertices.append(v)
    f = np.concatenate(faces)
    return ss.Scene(np.concatenate(vertices), f, np.zeros(len(f), int), room.materials, name="room")


def _plate(
    w: float, l: float, middle: tuple[float, float, float] = (3.0, 2.5, 1.5), n: int = 1
) -> tuple[np.ndarray, np.ndarray]:
    """A level rectangle of n x n squares, two triangles each."""
    x, y = np.meshgrid(
        np.linspace(-0.5, 0.5, n + 1) * w, np.linspace(-0.5, 0.5, n + 1) * l, indexing="ij"
    )
    v = np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=1) + middle
    i = (np.arange(n)[:, None] * (n + 1) + np.arange(n)).ravel()
    return v, np.concatenate(
        [np.stack([i, i + n + 1, i + n + 2], axis=1), np.stack([i, i + n + 2, i + 1], axis=1)]
    )


FREQUENCY = C / 0.5
NARROW = FREQUENCY * 0.9999, FREQUENCY * 1.0001


def _strip(u: float) -> np.ndarray:
    """(n, 5) hits on a strip u wide; with a = 4 m and a wavelength of 0.5 m, v is the distance."""
    x = u * (np.arange(4000) + 0.5) / 4000
    endless = np.full_like(x, np.inf)
    return np.stack([x, u - x, endless, endless, np.full_like(x, 4.0)], axis=1)


@pytest.mark.parametrize("u", few([0.3, 1.0, 3.0, 8.0], 1.0, 3.0))
def test_what_leaves_the_beam_is_found_outside(u: float) -> None:
    """The same wave's energy outside the beam, integrated, is what K lacks inside: nothing is lost or made."""
    rows = _strip(u)
    kept = kept_in_beam(rows, NARROW, C)[:, 0]
    lost = 1.0 - kept.mean()
    s, c = fresnel(rows[:, :2])
    fringes = 0.5 * (c.sum(axis=1) ** 2 + s.sum(axis=1) ** 2)
    assert lost == pytest.approx(1.0 - fringes.mean(), abs=1e-3)
    assert np.all((kept >= 0.0) & (kept <= 1.0))
    end, n = 400.0, 4_000_000
    t = end * (np.arange(n) + 0.5) / n
    (s0, c0), (s1, c1) = fresnel(t), fresnel(t + u)
    outside = ((c1 - c0) ** 2 + (s1 - s0) ** 2).sum() * end / n / u  # half of it, on both sides
    beyond = 2.0 / (np.pi**2 * end * u)  # the tail of 1 / (pi v)² on both sides
    assert lost == pytest.approx(outside + beyond, abs=2e-3 * lost + 2e-4)


def test_limits() -> None:
    """K = f / f_w with f_w = c a / w² (Rindel 1986) of a small strip; 1 / (pi u) leaves a wide one."""
    for u, expected in ((0.1, 1.0 - 0.1**2 / 2.0), (30.0, 1.0 / (30.0 * np.pi))):
        lost = 1.0 - kept_in_beam(_strip(u), NARROW, C).mean()
        assert lost == pytest.approx(expected, rel=0.03)


def _by_hand(w: float, l: float, hits: int, seed: int) -> np.ndarray:
    """(hits, B) 1 - K of single paths over a plate in the middle of the empty room, all legs by hand."""
    rng = np.random.default_rng(seed)
    place = np.column_stack(
        [rng.uniform(-0.5, 0.5, hits) * w, rng.uniform(-0.5, 0.5, hits) * l, np.zeros(hits)]
    )
    cos, phi = np.sqrt(rng.uniform(size=hits)), rng.uniform(0.0, 2.0 * np.pi, hits)
    sin = np.sqrt(1.0 - cos**2)
    d = np.column_stack([sin * np.cos(phi), sin * np.sin(phi), cos])

    def to_box(half: np.ndarray, p: np.ndarray, d: np.ndarray) -> np.ndarray:
        return np.asarray(((np.sign(d) * half - p) / np.where(d == 0.0, 1e-300, d)).min(axis=1))

    legs = [to_box(0.5 * ROOM, place, d * [s, s, 1.0]) for s in (-1.0, 1.0)]
    across = np.sqrt(1.0 - d[:, :2] ** 2)
    half = 0.5 * np.array([w, l])
    ends = [(half[i] + sign * place[:, i]) * across[:, i] for i in (0, 1) for sign in (1.0, -1.0)]
    rows = np.column_stack([*ends, legs[0] * legs[1] / (legs[0] + legs[1])])
    kept = np.zeros((hits, len(DEFAULT_BANDS) - 1))
    for band, (low, high) in enumerate(pairwise(log_edges(DEFAULT_BANDS))):
        f = low * (high / low) ** rng.uniform(size=hits)
        (s, c) = fresnel(rows[:, :4] * np.sqrt(2.0 * f[:, None] / (C * rows[:, 4:])))
        kept[:, band] = 0.25 * np.prod(
            [(c[:, i] + c[:, i + 1]) ** 2 + (s[:, i] + s[:, i + 1]) ** 2 for i in (0, 2)], axis=0
        )
    return 1.0 - kept


@pytest.mark.parametrize(("w", "l"), few([(0.3, 0.3), (1.0, 1.0), (2.5, 0.4)], (0.3, 0.3)))
def test_a_piece_scatters_as_the_paths_over_it_do(
    w: float, l: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its share is the mean of Rindel's K over places, directions and legs, by an integration that shares no ray."""
    monkeypatch.setattr(finite, "_LEAST", 4000)
    monkeypatch.setattr(finite, "_MOST", 4000)
    found = size_scattering(_in_room(_plate(w, l)), DEFAULT_BANDS, C)[12:].mean(axis=0)
    expected = _by_hand(w, l, 100_000, 1).mean(axis=0)
    np.testing.assert_allclose(found, expected, atol=0.02)  # ends to 1 cm, shares to 1/128


def test_what_has_no_end_scatters_nothing() -> None:
    assert size_scattering(box((6.0, 5.0, 2.7), table(0.2, 0.0)), DEFAULT_BANDS, C).max() == 0.0
    assert size_scattering(sphere(3.0, table(0.2, 0.0), 4), DEFAULT_BANDS, C).max() == 0.0
    ball = sphere(0.8, table(0.2, 0.0), 4)
    inside = size_scattering(_in_room((ball.vertices + [3.0, 2.5, 1.5], ball.faces)), DEFAULT_BANDS, C)
    assert inside[:12].max() == 0.0  # the walls do not see it as an end
    assert inside[12:].mean(axis=0)[0] > 0.2  # round, but small against a wave of metres


def test_a_door_is_an_end_and_a_corner_is_none() -> None:
    scattering = size_scattering(two_rooms(table(0.2, 0.0)), DEFAULT_BANDS, C)
    assert scattering[:12].max() == 0.0
    assert np.all(scattering[12:, 0] > 0.02)
    assert np.all(np.diff(scattering[12:], axis=1) <= 0.0)  # less, the shorter the wave


def test_bodies_scatter_outside_only() -> None:
    """A block that stands on the floor: its sides end at three of four edges, the floor nowhere."""
    block = _in_room(_cuboid([2.5, 2.0, 0.0], [3.5, 3.0, 1.0]))
    floating = _in_room(_cuboid([2.5, 2.0, 1.0], [3.5, 3.0, 2.0]))
    stands, floats = (size_scattering(s, DEFAULT_BANDS, C) for s in (block, floating))
    assert stands[:12].max() == 0.0
    sides = np.abs(block.normals[:, 2]) < 0.5
    sides[:12] = False
    assert np.all(stands[sides].mean(axis=0) < floats[sides].mean(axis=0))
    assert np.all(stands[sides].mean(axis=0) > 0.05)


def test_tessellation_does_not_matter() -> None:
    coarse, fine = (
        size_scattering(_in_room(_plate(1.2, 1.2, n=n)), DEFAULT_BANDS, C)[12:].mean(axis=0)
        for n in (1, 16)
    )
    np.testing.assert_allclose(fine, coarse, atol=0.08)


def test_surfaces_of_a_model() -> None:
    """1 - (1 - s)(1 - by size) of what is reflected; absorption and transmission stay; off, all is as the table says."""
    scene = _in_room(_plate(0.8, 0.6))
    by_size = size_scattering(scene, DEFAULT_BANDS, C)
    surfaces, of_face = scene_surfaces(scene, plain(scattering="size"), by_size)
    expected = 0.8 * (1.0 - 0.9 * (1.0 - by_size))
    np.testing.assert_allclose(surfaces.energy[of_face[:, 0], 0], expected, atol=1e-12)
    np.testing.assert_allclose(surfaces.energy.sum(axis=1), 0.8, atol=1e-12)
    plain_surfaces, rows = scene_surfaces(scene, plain(), scattered_by_size(scene, plain()))
    assert np.array_equal(rows, np.column_stack([scene.face_material, scene.face_material]))
    np.testing.assert_allclose(plain_surfaces.energy[:, 0], 0.08, atol=1e-12)


def test_a_mirror_reflection_is_weaker_by_what_is_scattered() -> None:
    scene, p, q = _in_room(_plate(1.0, 1.0)), [2.9, 2.5, 2.5], [3.15, 2.4, 2.6]
    levels = []
    for how in ("table", "size"):
        e = ss.simulate(scene, [p], [q], plain(walks=16, duration=0.05, scattering=how))[0, 0]
        length = np.linalg.norm(np.subtract(q, [2.9, 2.5, 0.5]))
        (arrival,) = (a for a in e.early if abs(a.delay * C - length) < 1e-6)
        levels.append(arrival.energy)
    by_size = size_scattering(scene, DEFAULT_BANDS, C)[12:]
    ratio = levels[1] / levels[0]
    assert np.isclose(1.0 - by_size, ratio, atol=1e-9).all(axis=1).any()
