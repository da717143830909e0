"""What a source emits is what walls and air absorb."""

import numpy as np
import pytest

import soundspaces_sim as ss
from soundspaces_sim.core.numerics.air import absorption
from tests.marks import CI_SLOW
from tests.rooms import box, plain, sphere, table, two_rooms
from tests.stats import assert_mean

BAND = (3409.0, 20000.0)


@pytest.mark.parametrize(
    "room", [pytest.param("box", marks=CI_SLOW), pytest.param("two rooms", marks=CI_SLOW)]
)
def test_the_air_of_a_lossless_room_absorbs_all_that_is_emitted(room: str) -> None:
    """m × (fluence, integrated over the volume) = 1 J for every mixture of lobes, in a band in which m changes
    ninefold.

    Air absorbs m per metre of the fluence at every place; nothing else absorbs here, so the mean over the
    room of the total fluence is 1 / (m V), of a band the mean of 1 / m over its frequencies by 1 / V. In the
    second scene half of what meets the partition passes it. The direct sound, whose mean over few listeners is
    known badly, is a control variate: its mean over the room is that of many places.
    """
    source, rng = np.array([1.5, 2.0, 1.2]), np.random.default_rng(0)
    if room == "box":
        size, scene = (6.0, 5.0, 2.7), box((6.0, 5.0, 2.7), table(0.0, 0.3))
    else:
        size = (8.0, 4.0, 2.5)
        scene = two_rooms(table([0.0, 0.0], [0.3, 0.5], [0.0, 0.5]), 1, door=False)
    config = ss.SimulationConfig(
        bands=BAND, walks=160, specular=ss.SpecularConfig(ratio=4), duration=2.5, max_bounces=2000,
        temperature_c=20.0, humidity_percent=20.0,
    )  # fmt: skip
    m = absorption(np.linspace(*BAND, 2001), 20.0, 20.0, 101.325)
    assert np.exp(-m.min() * 2.5 * 343.0) < 1e-3  # nothing is left

    def direct(places: np.ndarray) -> np.ndarray:
        r = np.linalg.norm(places - source, axis=1)
        passed = np.where((room == "box") | (places[:, 0] < 4.0), 1.0, 0.5)
        return np.asarray(passed * np.exp(-np.outer(r, m[::50])).mean(axis=1) / (4.0 * np.pi * r**2))

    everywhere = direct(rng.uniform(0.0, size, (400_000, 3)))
    expected = np.mean(1.0 / m) / np.prod(size)
    assert everywhere.std() / np.sqrt(len(everywhere)) < 0.002 * expected

    def mean_of_listeners(seed: int) -> float:
        listeners = rng.uniform(0.02, np.array(size) - 0.02, (128, 3))
        echoes = ss.simulate(scene, source, listeners, config, seed)
        total = np.array([echoes[0, i].histogram(0.1).sum() for i in range(len(listeners))])
        return float((total - direct(listeners)).mean() + everywhere.mean())

    assert_mean(np.array([mean_of_listeners(seed) for seed in range(8)]), expected, room, relative=0.02)


@pytest.mark.parametrize("transmission", [pytest.param(0.0, marks=CI_SLOW), 0.4])
def test_walls_absorb_and_pass_on_what_the_diffuse_field_brings(transmission: float) -> None:
    """Without air, a source in a Lambert sphere's centre: all of it goes into or through the wall.

    Of what meets the wall the share a + t leaves, so the energy that meets it adds up to 1 / (a + t), the
    first 1 of which comes straight. The wall is lit evenly, and a Lambert wall that returns P over its
    area makes the fluence P / (pi R^2) everywhere inside.
    """
    radius, a = 2.0, 0.3
    returned = (1.0 - a - transmission) / (a + transmission)
    config = plain(walks=800, specular={"ratio": 1}, connections={"subpaths": 64}, decay_range_db=100.0)
    scene = sphere(radius, table(a, 1.0, transmission), 4)
    totals = [
        ss.simulate(scene, [0.0, 0.0, 0.0], [0.4, 0.0, 0.2], config, seed)[0, 0]
        .energy[:, 0]
        .sum(axis=0)[0]
        for seed in range(12)
    ]
    assert_mean(np.array(totals), returned / (np.pi * radius**2), "sphere", relative=0.03)
