"""Echograms between points against simulation at the very places."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from soundspaces_continuous.sound_field import SoundField

import soundspaces_sim as ss
import soundspaces_sim.nav as nav
from soundspaces_sim.core.simulation_config import RadianceTransferConfig
from tests.nav.conftest import LADDER, T_CORRIDOR, lattice_scene

SCENES = {"ladder": lattice_scene(LADDER, "ladder"), "tee": lattice_scene(T_CORRIDOR, "tee")}


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
        walks=16, connections=ss.ConnectionsConfig(subpaths=2), duration=0.05, reflection="random",
        radiance_transfer=RadianceTransferConfig(enabled=False),
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
