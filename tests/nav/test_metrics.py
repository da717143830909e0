"""Measures of trajectories counted by hand, and of the rewards that go with them."""

from __future__ import annotations

import numpy as np
import pytest

from soundspaces_sim.nav.data import NavData
from soundspaces_sim.nav.episode_state import EpisodeState
from soundspaces_sim.nav.episodes import make_episode
from soundspaces_sim.nav.evaluate import Interval, Result, _dtype, _interval
from soundspaces_sim.nav.metrics import Metrics, episode_metrics
from soundspaces_sim.nav.navigation_graph import FORWARD, LEFT, RIGHT, STOP
from soundspaces_sim.nav.task import TaskOptions
from tests.marks import few
from tests.nav.conftest import T_CORRIDOR

F, L, R, S = FORWARD, LEFT, RIGHT, STOP


def walked(
    data: NavData, start: tuple[int, int], heading: int, goal: tuple[int, int], actions: list[int]
) -> EpisodeState:
    graph = data.graph("tee")
    episode = make_episode(
        graph, "0", T_CORRIDOR.index(start), heading, T_CORRIDOR.index(goal), "telephone"
    )
    state = EpisodeState(graph, episode, TaskOptions())
    for action in actions:
        state.move(action)
    return state


def test_shortest_way(data: NavData) -> None:
    """(0,3) facing east to (3,0): three steps, a turn right, three steps, STOP: 8 actions, 6 m."""
    state = walked(data, (0, 3), 0, (3, 0), [F, F, F, R, F, F, F, S])
    assert state.episode.distance == 6.0 and state.episode.actions == 8
    assert state.metrics() == Metrics(1, 1, 1, 1, 1, 8, 0, 0, 0)


def test_long_way(data: NavData) -> None:
    """A detour of one step east and back (4 more actions by two turns), a bump: p = 8, n = 8 + 1 + 1 + 2 + 1 + 1."""
    state = walked(data, (0, 3), 0, (3, 0), [F, F, F, F, L, F, L, F, L, F, F, F, S])
    # east to (4,3), turn, bump into the wall, turn, back west to (3,3), turn south, down, STOP
    assert state.metrics() == Metrics(1, 1, 6 / 8, 6 / 8, 8 / 13, 13, 0, 0, 1)


def test_stop_too_early(data: NavData) -> None:
    """One step of six, then STOP: no success; a metre from the goal is none either, not even within 1 m."""
    state = walked(data, (0, 3), 0, (3, 0), [F, S])
    assert state.metrics() == Metrics(0, 0, 0, 1 - 5 / 6, 0, 2, 5, 5 / 6, 0)
    near = walked(data, (3, 1), 270, (3, 0), [S])
    assert near.metrics().success_1m == 0.0 and near.metrics().distance_to_goal == 1.0


def test_half_a_metre_is_success_for_habitat_alone() -> None:
    found = episode_metrics(
        start_distance=4.0, distance=0.5, path=3.5, actions=9, fewest=10, collisions=2, stopped=True
    )
    assert (found.success, found.success_1m, found.spl, found.sna) == (0.0, 1.0, 0.0, 0.0)
    assert found.softspl == pytest.approx(1 - 0.5 / 4.0)
    within = episode_metrics(
        start_distance=4.0, distance=0.5, path=8.0, actions=20, fewest=10, collisions=0, stopped=True,
        success_radius=0.5,
    )  # fmt: skip
    assert (within.success, within.spl, within.sna) == (1.0, 0.5, 0.5)


def test_rewards(data: NavData) -> None:
    graph = data.graph("tee")
    episode = make_episode(
        graph, "0", T_CORRIDOR.index((2, 3)), 0, T_CORRIDOR.index((3, 2)), "telephone"
    )
    state = EpisodeState(graph, episode, TaskOptions(max_steps=4))
    got = [state.move(a) for a in (LEFT, RIGHT, FORWARD, LEFT)]
    assert [r for r, *_ in got] == pytest.approx([-0.01, -0.01, 0.99, -0.01])
    assert [over for _, *over in got] == [[False, False]] * 3 + [[False, True]]
    state = EpisodeState(graph, episode, TaskOptions(max_steps=5))
    rewards = [state.move(a)[0] for a in (FORWARD, RIGHT, FORWARD, STOP)]
    assert rewards == [pytest.approx(r) for r in (0.99, -0.01, 0.99, 9.99)]


def test_reward_per_step_of_the_grid() -> None:
    """`step` counts edges: on a half-metre grid a step is 1, not 0.5."""
    from soundspaces_sim.nav.navigation_graph import NavigationGraph
    from tests.nav.test_navigation_graph import fake

    ds = fake([(0, 0), (0.5, 0), (1.0, 0)], [(0, 1), (1, 2)])
    ds.manifest.config.grid.spacing = 0.5
    graph = NavigationGraph(ds)
    episode = make_episode(graph, "0", 0, 0, 2, "telephone")
    for reward, expected in (("metre", 0.49), ("step", 0.99)):
        state = EpisodeState(graph, episode, TaskOptions(distance_reward=reward))  # type: ignore[arg-type]
        assert state.move(FORWARD)[0] == pytest.approx(expected)


def test_intervals_that_hold_for_many_comparisons_together() -> None:
    """Of 4,000 families of 20 differences that are none, 95.1 % have no interval that excludes 0: (1 - .05 / 20)^20."""
    rng = np.random.default_rng(0)
    found = rng.standard_normal((4000, 20))
    one = Interval(0.0, -1.0, 1.0, 1.0)
    assert one.among(1).high == pytest.approx(1.959964, abs=1e-6)
    reach = one.among(20).high
    share = float((np.abs(found) <= reach).all(axis=1).mean())
    expected = (1.0 - 0.05 / 20) ** 20
    assert abs(share - expected) < 4.0 * np.sqrt(expected * (1.0 - expected) / 4000)


@pytest.mark.parametrize(("scenes", "seeds"), few([(4, 1), (4, 3), (8, 3), (16, 3)], (4, 1)))
def test_intervals_over_few_homes_cover_what_they_say(scenes: int, seeds: int) -> None:
    """Homes, seeds and episodes vary about a known mean: 95 % of intervals hold it. Their sum of variances counts
    single episodes twice, so that more than 95 % may; the most is bounded, too, for an endless interval covers all."""
    rng, trials, episodes = np.random.default_rng(scenes * 10 + seeds), 1500, 10
    rows = np.zeros(scenes * seeds * episodes, _dtype())
    shape = (scenes, seeds, episodes)
    home, run, walk = (index.ravel() for index in np.indices(shape))
    rows["scene"], rows["seed"] = home.astype(str), run
    rows["episode_id"] = [f"{h}-{e}" for h, e in zip(home, walk, strict=True)]
    held, held_together = 0, 0
    for _ in range(trials):
        spread = 0.1 * rng.standard_normal((scenes, 1, 1)) + 0.05 * rng.standard_normal(
            (1, seeds, 1)
        ) * (seeds > 1)
        rows["spl"] = (0.4 + spread + 0.2 * rng.standard_normal(shape)).ravel()
        found = _interval(rows, rows["spl"])
        held += found.low <= 0.4 <= found.high
        many = found.among(20)
        held_together += many.low <= 0.4 <= many.high
    binomial = np.sqrt(0.95 * 0.05 / trials)
    assert 0.95 - 4.0 * binomial <= held / trials <= 0.985
    expected = 1.0 - 0.05 / 20
    assert held_together / trials >= expected - 4.0 * np.sqrt(expected * (1.0 - expected) / trials)


def test_no_interval_of_one_episode() -> None:
    rows = np.zeros(2, _dtype())
    rows["scene"], rows["episode_id"], rows["seed"], rows["spl"] = "a", "0", [0, 1], [0.2, 0.6]
    found = Result("x", rows).summary()["spl"]
    assert found.mean == pytest.approx(0.4) and not np.isfinite([found.low, found.high]).any()
    assert str(found) == "0.400 (no interval)"


def test_the_standard_error_of_a_mean() -> None:
    """Of one scene, n episodes and one seed it is s / sqrt(n)."""
    rows = np.zeros(400, _dtype())
    rows["episode_id"] = [str(k) for k in range(400)]
    rows["spl"] = np.random.default_rng(1).random(400)
    result = Result("x", rows)
    error = result.summary()["spl"].error
    assert error == pytest.approx(rows["spl"].std(ddof=1) / 20.0)
    two = Result("x", np.concatenate([rows, rows]))
    two.rows["seed"][400:] = 1
    two.rows["spl"][400:] += 1.0
    np.testing.assert_allclose(two.by_seed(), [rows["spl"].mean(), rows["spl"].mean() + 1.0])
