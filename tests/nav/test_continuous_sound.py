"""Echograms between points against simulation at the very places, and blocks against whole responses."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import scipy.signal

import soundspaces_sim as ss
import soundspaces_sim.nav as nav
from soundspaces_sim.core.simulation_config import RadianceTransferConfig
from soundspaces_sim.nav.cache import BlockCache
from soundspaces_sim.nav.continuous.signals import SourceSignal
from soundspaces_sim.nav.continuous.sound_field import SoundField
from soundspaces_sim.nav.continuous.step_renderer import Sounding, StepRenderer
from tests.nav.conftest import LADDER, T_CORRIDOR, lattice_scene
from tests.nav.continuous_twin import below

SCENES = {"ladder": lattice_scene(LADDER, "ladder"), "tee": lattice_scene(T_CORRIDOR, "tee")}
BLOCK, FADE, RATE = 4000, 192, 16000


@pytest.fixture(scope="module", params=["ladder", "tee"])
def field(request: pytest.FixtureRequest, graphs: Any) -> SoundField:
    return SoundField(nav.NavData(graphs).dataset(request.param), SCENES[request.param])


@pytest.fixture(scope="module")
def moved(field: SoundField) -> SoundField:
    return SoundField(field.ds, field.scene, paths="moved")


def names(echogram: Any) -> dict[tuple[Any, ...], Any]:
    """Arrivals by what they met; two planes at right angles give one image in either order."""
    return {(a.kind, tuple(sorted(a.planes)), a.edges): a for a in echogram.early}


def test_at_a_point_it_is_that_point(field: SoundField) -> None:
    ds = field.ds
    for s, l in np.random.default_rng(0).integers(0, len(ds.points), (25, 2)):
        own, found = ds.echogram(s, l), field.echogram(field.at_point(s), field.place(ds.points[l]))
        assert np.array_equal(own.energy, found.energy) and own.visible == found.visible
        assert (own.direct is None) == (found.direct is None)
        for a, b in zip(own.arrivals, found.arrivals, strict=True):
            assert (a.kind, a.planes, a.edges) == (b.kind, b.planes, b.edges)
            assert b.delay == pytest.approx(a.delay, abs=1e-7)
            assert b.energy == pytest.approx(a.energy, rel=1e-3)
            assert b.direction == pytest.approx(a.direction, abs=1e-6)


def test_at_a_point_moved_paths_are_those_of_that_point(moved: SoundField) -> None:
    ds, lost, count = moved.ds, 0, 0
    for s, l in np.random.default_rng(0).integers(0, len(ds.points), (25, 2)):
        own, found = ds.echogram(s, l), moved.echogram(moved.at_point(s), moved.place(ds.points[l]))
        assert np.array_equal(own.energy, found.energy) and own.visible == found.visible
        assert (own.direct is None) == (found.direct is None)
        if own.direct is not None and found.direct is not None:
            assert found.direct.delay == pytest.approx(own.direct.delay, abs=1e-7)
            assert found.direct.energy == pytest.approx(own.direct.energy, rel=1e-3)
        a, b = names(own), names(found)
        assert not set(b) - set(a)
        lost, count = lost + len(set(a) - set(b)), count + len(a)
        for name in set(a) & set(b):
            assert b[name].delay == pytest.approx(a[name].delay, abs=3e-5)
            assert b[name].energy.sum() >= 0.99 * a[name].energy.sum()
    assert lost <= 0.05 * count  # paths through the very edges of corners, in these lattices


def between(field: SoundField) -> tuple[list[np.ndarray], Any]:
    """Places between points, and what is simulated there from the third point."""
    rng, ds = np.random.default_rng(1), field.ds
    places: list[np.ndarray] = []
    while len(places) < 8:
        k = rng.integers(len(ds.points))
        places.append(ds.points[k] + [*rng.uniform(-0.38, 0.38, 2), 0.0])
    config = ss.SimulationConfig(
        walks=16, connections=ss.ConnectionsConfig(subpaths=2), duration=0.05, radiance_transfer=RadianceTransferConfig(enabled=False)
    )  # fmt: skip
    return places, ss.simulate(field.scene, ds.points[[2]], np.array(places), config)


def test_between_points_arrivals_are_those_simulated_there(field: SoundField) -> None:
    """All discrete arrivals, which have no statistical error, by what they met: when, from where, and how strong in
    every band, as a simulation at the place finds them."""
    places, there = between(field)
    edges = 0
    for i, place in enumerate(places):
        own, found = there[0, i], field.echogram(field.at_point(2), field.place(place))
        assert own.visible == found.visible and (own.direct is None) == (found.direct is None)
        for a, b in zip(own.arrivals, found.arrivals, strict=True):
            assert (a.kind, a.planes, a.edges) == (b.kind, b.planes, b.edges)
            assert b.delay == pytest.approx(a.delay, abs=1e-8)
            assert b.direction == pytest.approx(a.direction, abs=1e-6)
            assert b.energy == pytest.approx(a.energy, rel=1e-3)
            edges += len(a.edges)
    assert edges >= 8


def test_between_points_moved_images_are_found(moved: SoundField) -> None:
    """Direct sound and mirror images: images with four fifths of the energy that a simulation at the place finds are
    found, at their delay, from their direction; nothing else is heard. The rest is of images that no point around
    has: here, where points of the lattice lie in planes of symmetry, in corners. Their energies are those of the
    points: beside edges these change within the spacing (`accuracy.continuous` has by how much)."""
    places, there = between(moved)
    got = want = 0.0
    for i, place in enumerate(places):
        own, found = there[0, i], moved.echogram(moved.at_point(2), moved.place(place))
        assert own.visible == found.visible
        if own.visible:
            assert own.direct is not None and found.direct is not None
            assert found.direct.delay == pytest.approx(own.direct.delay, abs=1e-8)
            assert found.direct.direction == pytest.approx(own.direct.direction, abs=1e-6)
        a = {k: x for k, x in names(own).items() if k[0] == "mirrors"}
        b = {k: x for k, x in names(found).items() if k[0] == "mirrors"}
        assert not set(b) - set(a)
        want += sum(float(x.energy[1]) for x in a.values())
        for name in set(a) & set(b):
            got += float(a[name].energy[1])
            assert b[name].delay == pytest.approx(a[name].delay, abs=1e-8)
            assert b[name].direction == pytest.approx(a[name].direction, abs=1e-6)
    assert got > 0.8 * want


def test_weights(field: SoundField) -> None:
    """Shares sum to one and change with the place without jumps where nothing is between."""
    rng = np.random.default_rng(2)
    for _ in range(30):
        point = field.ds.points[rng.integers(len(field.ds.points))]
        a = field.place(point + [*rng.uniform(-0.38, 0.38, 2), 0.0])
        assert sum(a.shares) == pytest.approx(1.0) and list(a.shares) == sorted(a.shares, reverse=True)
        b = field.place(a.position + [1e-4, 0.0, 0.0])
        before, after = (
            dict(zip(a.points, a.shares, strict=True)),
            dict(zip(b.points, b.shares, strict=True)),
        )
        if set(before) == set(after):
            assert max(abs(before[k] - after[k]) for k in before) < 2e-3


def test_reverberation_is_the_mean_by_shares(field: SoundField) -> None:
    place = field.place(field.ds.points[1] + [0.2, 0.1, 0.0])
    found = field.echogram(field.between(2, 3, 0.3), place).energy
    expected = sum(
        of_s * of_l * field.ds.echogram(s, l).energy.astype(float)
        for s, of_s in ((2, 0.7), (3, 0.3))
        for l, of_l in zip(place.points, place.shares, strict=True)
    )
    assert np.allclose(found, expected, rtol=1e-5, atol=1e-12)


def renderer(field: SoundField, fade: int = FADE) -> StepRenderer:
    return StepRenderer(field, BLOCK, fade, BlockCache(10**9))


def test_blocks_at_a_point_are_the_datasets_rendering(field: SoundField) -> None:
    """Any heading, at rest: all blocks together are the signal through the whole response, as datasets render it."""
    made, ds = renderer(field), field.ds
    signal = np.random.default_rng(3).standard_normal(20000).astype(np.float32)
    for s, l, heading in ((0, 3, 0.0), (4, 1, 37.3), (2, 6, 211.0)):
        tail, blocks = None, []
        source = Sounding(SourceSignal("noise", signal, 0, 20000), field.at_point(s))
        for j in range(6):
            block, tail = made.hear(j, [source], field.place(ds.points[l]), np.deg2rad(heading), tail)
            blocks.append(block)
        response = ds.rendered(
            field.echogram(field.at_point(s), field.place(ds.points[l])), s, l, heading
        )
        whole = np.stack([scipy.signal.fftconvolve(signal, ear) for ear in response])
        found = np.concatenate(blocks, axis=1)
        n = min(found.shape[1], whole.shape[1])
        error = below(found[:, :n] - whole[:, :n], 6000.0)
        assert np.abs(error).max() < 2e-3 * np.abs(whole).max()


def test_no_click_at_a_step(field: SoundField) -> None:
    """A low tone while the agent steps and turns: its second difference stays what a tone's is; without a cross-fade
    it jumps. Curvature of a tone of amplitude A: A (2 pi f / rate)²."""
    tone = np.sin(2.0 * np.pi * 100.0 * np.arange(RATE) / RATE).astype(np.float32)
    source = Sounding(SourceSignal("tone", tone, -RATE * 100, 10**9), field.at_point(0))

    def bend(fade: int) -> float:
        made, tail, blocks = renderer(field, fade), None, []
        for j in range(8):
            place = field.place(field.ds.points[1] + [0.0, -0.3 + 0.08 * j, 0.0])
            block, tail = made.hear(j, [source], place, 0.26 * j, tail)
            blocks.append(block)
        heard = np.concatenate(blocks[4:], axis=1).astype(float)
        curved = np.abs(np.diff(heard, 2, axis=1)).max()
        return float(curved / (np.abs(heard).max() * (2.0 * np.pi * 100.0 / RATE) ** 2))

    smooth, hard = bend(FADE), bend(1)
    assert smooth < 3.0 and hard > 5.0 * smooth


def test_a_source_on_its_way_is_heard_from_there(field: SoundField) -> None:
    """Delay and level of the direct sound of a source between two points: c and 1 / r."""
    made, place = renderer(field), field.place(field.ds.points[1])
    click = np.zeros(BLOCK, np.float32)
    click[0] = 1.0
    for share in (0.0, 0.25, 0.6, 1.0):
        source = field.between(2, 3, share)
        heard, _ = made.hear(
            0, [Sounding(SourceSignal(f"c{share}", click, 0, BLOCK), source)], place, 0.0
        )
        apart = float(np.linalg.norm(source.position - place.position))
        both = np.abs(scipy.signal.hilbert(below(heard, 6000.0))).sum(axis=0)
        assert abs(int(both[:2000].argmax()) - apart / 343.0 * RATE) < 12
