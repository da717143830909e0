"""Degenerate scenes and extreme materials: no NaN, no hang, no energy from nothing."""

import re
from typing import Any

import numpy as np
import pytest

import soundspaces_sim as ss
from soundspaces_sim.transport import bsdf
from soundspaces_sim.transport.integrator import simulate_tile
from soundspaces_sim.transport.model import Model
from soundspaces_sim.transport.preparation import at_duration, at_points, make_model
from soundspaces_sim.transport.radiance_transfer.prepared import late_technique
from soundspaces_sim.transport.techniques import TECHNIQUES
from tests.marks import CI_SLOW, ci_slow
from tests.rooms import box, plain, plane, table
from tests.stats import assert_mean, repeat

SIZE, P, Q = (6.0, 5.0, 2.7), [[1.0, 1.0, 1.2]], [[4.0, 3.0, 1.5]]


def _run(scene: ss.Scene, p: Any, q: Any, **settings: Any) -> np.ndarray:
    """(bands,) total energy of a finite, non-negative echogram that renders to finite sound."""
    config = ss.SimulationConfig(**{"walks": 400, "connections": {"subpaths": 16}, **settings})
    e = ss.simulate(scene, p, q, config)
    assert np.isfinite(e.energy).all() and (e.energy[:, :, :, 0] >= 0.0).all()
    assert (e.relative_error >= 0.0).all()  # infinite where it is not known
    rir = ss.ambisonic_rir(e[0, 0], 16000)
    assert np.isfinite(rir).all() and np.isfinite(ss.binaural_rir(rir, 16000)).all()
    return np.asarray(e[0, 0].histogram().sum(axis=1))


@pytest.mark.parametrize(
    ("a", "s", "t"),
    [(0, 1, 0), (0, 0, 0), (1, 1, 0), (1, 0, 0), (0, 0.5, 1), (0, 0, 1), (0.5, 0.5, 0.5), (0, 0.3, 0.5)],
)
def test_extreme_materials(a: float, s: float, t: float) -> None:
    total = _run(box(SIZE, table(a, s, t)), P, Q, duration=0.5)
    direct = 1.0 / (4.0 * np.pi * (9.0 + 4.0 + 0.09))
    if a == 1 or t == 1 or a + t == 1:  # nothing comes back: the direct sound alone
        assert total[0] == pytest.approx(direct, rel=0.01)
    else:
        assert total[0] > direct


@pytest.mark.parametrize("scattering", [0.3, *(pytest.param(s, marks=CI_SLOW) for s in (0.0, 1.0))])
def test_energy_of_a_lossless_room_is_the_emitted_energy(scattering: float) -> None:
    """Without losses the mean energy density is 1 J / V for ever: fluence c t / V, whatever scatters."""
    size = (4.0, 3.2, 2.2)
    scene, ends = box(size, table(0.0, scattering)), ([[1.0, 1.0, 1.2]], [[3.0, 2.2, 1.5]])
    config = plain(walks=400, duration=0.3, max_bounces=1000)
    late = repeat(lambda seed: ss.simulate(scene, *ends, config, seed)[0, 0].histogram(0.1)[0, 1:3], 8)
    assert_mean(late, 343.0 * 0.1 / np.prod(size), "lossless", relative=0.03)


@pytest.mark.parametrize(
    ("p", "q"),
    [
        ([1.0, 1.0, 0.0], [2.0, 2.0, 0.0]),  # on the floor
        ([0.0, 0.0, 0.0], list(SIZE)),  # in two corners
        (P[0], P[0]),  # co-located
        ([0.05, 0.05, 0.05], [0.1, 0.05, 0.05]),  # 5 cm from three walls
    ],
)
def test_awkward_points(p: list[float], q: list[float]) -> None:
    assert np.all(_run(box(SIZE, table(0.1, 0.5)), p, q) > 0.0)


@ci_slow
def test_slivers_duplicates_and_distant_origins() -> None:
    """Faces twice, a face without width, an origin 5.8 km away: the same energy, within 2 % of it."""
    room = box(SIZE, table(0.1, 0.5))
    vertices = np.concatenate([room.vertices, [[1, 1, 1], [2, 1, 1], [1.5, 1 + 1e-9, 1]]])
    faces = np.concatenate([room.faces, room.faces, [[8, 9, 10]]])
    dirty = ss.Scene(vertices, faces, np.zeros(len(faces), int), table(0.1, 0.5))
    shift = np.array([5000.0, -3000.0, 100.0])
    moved = ss.Scene(room.vertices + shift, room.faces, np.zeros(12, int), table(0.1, 0.5))

    def run(scene: ss.Scene, by: np.ndarray, first: int) -> np.ndarray:
        config = plain(walks=400, connections={"subpaths": 16}, duration=0.4)
        return repeat(
            lambda seed: (
                ss.simulate(scene, P + by, Q + by, config, seed)[0, 0].histogram().sum(axis=1)[:1]
            ),
            16,
            first,
        )

    reference = run(room, np.zeros(3), 0)
    for k, (scene, by) in enumerate(((dirty, np.zeros(3)), (moved, shift))):
        assert np.isfinite(_run(scene, P + by, Q + by, duration=0.4)).all()
        assert_mean(
            run(scene, by, 100 * (k + 1)) - reference, 0.0, "dirty or moved", scale=reference.mean()
        )


def test_one_triangle() -> None:
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], float)
    scene = ss.Scene(corners, np.array([[0, 1, 2]]), np.array([0]), table(0.1, 0.5))
    p, q, direct = [0.2, 0.2, 1.0], [0.3, 0.1, 2.0], 1.0 / (4.0 * np.pi * 1.02)
    assert _run(scene, p, q, diffraction={"enabled": False})[0] > direct
    # The triangle's reflection interferes: its pressure is at most an endless mirror's, .32 of the direct sound's.
    mirrored = np.sqrt(0.9) * np.sqrt(1.02) / np.linalg.norm([0.1, 0.1, 3.0])
    assert _run(scene, p, q)[0] > (1.0 - mirrored) ** 2 * direct


def test_a_point_shut_in_furniture_hears_nothing() -> None:
    room, chest = box(SIZE, table(0.1, 0.5)), box((0.6, 0.6, 0.6), table(0.1, 0.5))
    scene = ss.Scene(
        np.concatenate([room.vertices, chest.vertices + [2.0, 2.0, 0.0]]),
        np.concatenate([room.faces, chest.faces + 8]), np.zeros(24, int), table(0.1, 0.5),
    )  # fmt: skip
    assert np.all(_run(scene, [2.3, 2.3, 0.3], Q) == 0.0)


@ci_slow
def test_few_bounces_bands_and_short_durations() -> None:
    room = box(SIZE, table(0.1, 0.5))
    few, many = _run(room, P, Q, max_bounces=1, duration=0.3), _run(room, P, Q, duration=0.3)
    assert np.all(few < many)
    assert np.all(_run(room, P, Q, duration=0.01) > 0.0)
    assert len(_run(room, P, Q, bands=(0, 20000), duration=0.1)) == 1
    octaves = tuple(125.0 * 2.0 ** (np.arange(8) - 0.5))
    assert len(_run(room, P, Q, bands=octaves, duration=0.1)) == 7


@pytest.mark.parametrize(
    "settings",
    [
        {"duration": 0.1, "time_grid": ((0.0, 0.1),)},
        {"duration": 0.21, "connections": {"window": 0.205, "subpaths": 16}},
    ],
)
def test_no_bin_begins_after_the_window_of_connections(settings: dict[str, object]) -> None:
    """The last bin begins within it: there is nothing for patches to do."""
    assert np.all(_run(box(SIZE, table(0.1, 0.5)), P, Q, **settings) > 0.0)


def test_open_air_over_a_plane_ends_soon() -> None:
    assert np.all(_run(plane(3.0, table(0.0, 0.0, 0.0)), [0.0, 0.0, 1.0], [1.0, 0.0, 1.0]) > 0.0)


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({}, r"radiance transfer, with \d+ patches and 16 transfer subpaths from each"),
        ({"radiance_transfer": False}, "receiver volumes, as radiance transfer is off"),
        ({"duration": 0.05}, "receiver volumes, as there is none after the window of connections"),
        (
            {"duration": 0.1, "time_grid": ((0.0, 0.1),)},
            "receiver volumes, as there is none after the window",
        ),
    ],
)
def test_it_is_said_who_makes_late_sound(
    settings: dict[str, object], said: str, caplog: pytest.LogCaptureFixture
) -> None:
    config = plain(**{"walks": 64, "duration": 0.2, "radiance_transfer": True, **settings})
    with caplog.at_level("INFO", logger="soundspaces_sim"):
        make_model(box((4.0, 3.0, 2.5), table(0.2, 0.3)), np.array([[1.0, 1.0, 1.0]]), config)
    assert re.search(said, caplog.text)


def test_mirrors_alone_need_no_middle() -> None:
    scene = box((4.0, 3.0, 2.5), table(0.2, 0.0))
    model = make_model(scene, np.array([[1.0, 1.0, 1.0]]), plain(duration=0.2, radiance_transfer=True))
    assert late_technique(model).startswith("receiver volumes, as no surface")


def test_patches_are_refused_a_lobe_that_is_not_lambertian(monkeypatch: pytest.MonkeyPatch) -> None:
    """They carry Lambertian lobes alone: late sound of another was lost. The specular row stands in for such a
    lobe, after the models were made: kernels do not see it. Materials that no face has do not count."""
    mixed = table([0.2, 0.2], [0.3, 1.0])  # the second one has no specular lobe
    config, points = plain(walks=64, duration=0.2, radiance_transfer=True), np.array([[1.0, 1.0, 1.0]])
    uneven, even = (make_model(box((4.0, 3.0, 2.5), mixed, row), points, config) for row in (0, 1))

    def again(model: Model) -> Model:
        return at_duration(model.prepared, 0.2)

    assert all(late_technique(again(model)).startswith("radiance transfer") for model in (uneven, even))
    monkeypatch.setattr(bsdf, "DELTA", np.array([False, False, True]))
    refused = again(uneven)
    assert late_technique(refused).startswith("receiver volumes, as lobe 'specular' is not Lambertian")
    assert not refused.world.settings.radiance_transfer and len(refused.world.patches.weight) == 0
    # its subpaths are those that live on after the connection window
    assert refused.world.settings.subpaths == refused.world.settings.round
    assert not at_points(refused.prepared, points + 0.5).world.settings.radiance_transfer
    assert again(even).world.settings.radiance_transfer


def test_a_technique_without_what_it_requires_is_refused() -> None:
    model = make_model(
        box((4.0, 3.0, 2.5), table(0.2, 0.3)), np.array([[1.0, 1.0, 1.0]]), plain(duration=0.1)
    )
    alone = [t for t in TECHNIQUES if t.name == "connections"]
    with pytest.raises(ss.ConfigError, match="connections: needs receiver_volumes before it"):
        simulate_tile(model, np.array([[1.0, 1.0, 1.0]]), None, techniques=alone)
