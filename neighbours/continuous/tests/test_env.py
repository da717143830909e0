"""`SoundSpaces/AudioGoalContinuous-v0`: Gymnasium's rules, an independent twin, measures by hand, bad input."""

from __future__ import annotations

import math
import pickle
from typing import Any, cast

import gymnasium
import numpy as np
import pytest
import soundspaces_continuous as continuous
from gymnasium.utils.env_checker import check_env
from soundspaces_continuous.agents import EAR_S, direction_of, interaural_delay
from soundspaces_continuous.env import ContinuousNavEnv, ContinuousNavVectorEnv
from soundspaces_continuous.map_page import _page
from soundspaces_continuous.savnce import savnce_options, savnce_own_sensors
from soundspaces_continuous.sensor_suite import interaural
from soundspaces_continuous.world import ContinuousWorld

import soundspaces_sim.nav as nav
from neighbours.continuous.tests.twin import BLOCK, RATE, Twin, below
from soundspaces_sim.core.errors import ConfigError, EpisodeError, PointError
from tests.marks import ci_slow
from tests.nav.conftest import LADDER, T_CORRIDOR, lattice_scene

SCENES = {"ladder": lattice_scene(LADDER, "ladder"), "tee": lattice_scene(T_CORRIDOR, "tee")}
NEAR_M = 0.5  # 23 samples at 16 kHz: half a windowed sinc (16 samples) and what ear filters are ahead
HEARD = ("audiogoal", "pose", "collision")


def make(data: Any, **options: Any) -> ContinuousNavEnv:
    given: dict[str, Any] = {
        "scenes": SCENES,
        "sensors": HEARD,
        "rules": continuous.Rules(min_distance=2.0),
    }
    return ContinuousNavEnv(data, **{**given, **options})


def replay(data: Any, first: int, episodes: int, steps: int, paths: str = "moved") -> int:
    """Walk episodes beside the twin; the number of steps compared."""
    rules = continuous.Rules(1, 1, 2.0, (0.0, 0.6), (0.7, 2.0), 1.0)
    compared = 0
    for k in range(first, first + episodes):
        rng = np.random.default_rng(k)
        slide = bool(k % 2)
        env = make(
            data,
            rules=rules if k % 3 else continuous.Rules(2, 0, 2.0),
            sounds="test",
            slide=slide,
            paths=paths,
        )
        observation, info = env.reset(seed=k)
        assert env.state is not None
        twin, heard, expected, apart = Twin(env, env.state.episode), [], [], []
        while True:
            heard.append(observation["audiogoal"])
            expected.append(twin.hear())
            apart.append(twin.nearest_source())
            assert abs(env.state.x - twin.p[0]) + abs(env.state.y - twin.p[1]) < 1e-7
            for name, value in twin.measures().items():
                assert info[name] == pytest.approx(value, abs=1e-6), name
            compared += 1
            if env.state.over:
                break
            action = (
                0
                if twin.steps == steps
                else env.state.oracle_action()
                if k % 2
                else int(rng.integers(1, 4))
            )
            observation, _, _, _, info = env.step(action)
            twin.act(action, slide)
        whole, other = below(np.concatenate(heard, axis=1)), below(np.concatenate(expected, axis=1))
        assert np.abs(other).max() > 0.0
        error = np.abs(whole - other).reshape(2, -1, BLOCK).max(axis=(0, 2)) / np.abs(other).max()
        # Single precision, and the air of moved paths to first order: within 1.5 m, 2e-5 at 3 kHz. Where a source is
        # so near that its sound arrives within the filters' first taps, what these bring before it is emitted
        # is cut, by either in its own way: at this step and, cross-faded, the next.
        near = np.array(apart) < NEAR_M
        near[1:] |= near[:-1]
        assert error[~near].max(initial=0.0) < 1e-3, k
        assert error[near].max(initial=0.0) < 1e-2, k
    return compared


def test_actions_of_drawn_episodes_are_the_oracles(data: nav.NavData) -> None:
    """The kernel that counts them walks as the state does: with slides and without, steps that do not divide ways,
    and more actions than are allowed."""
    for options in ({}, {"slide": False, "turn_deg": 30.0}, {"forward": 0.37, "max_steps": 9}):
        env, counts = make(data, sensors=("pose",), **options), set()
        for seed in range(25):
            env.reset(seed=seed)
            state = env.state
            assert state is not None
            while not state.over:
                state.move(state.oracle_action())
            assert state.episode.actions == state.steps, (options, seed)
            counts.add(state.steps)
        assert len(counts) > 4 or options.get("max_steps") == 9


@ci_slow
def test_twin(data: nav.NavData) -> None:
    assert replay(data, 0, 2, 6) >= 10


def test_twin_with_simulated_paths(data: nav.NavData) -> None:
    assert replay(data, 100, 2, 4, "simulated") >= 8


@pytest.mark.slow
def test_twin_of_sixty_episodes(data: nav.NavData) -> None:
    assert replay(data, 100, 60, 12) >= 400


def test_gymnasiums_rules(data: nav.NavData) -> None:
    sensors = ("audiogoal", "spectrogram", "interaural", "intensity", "depth", "pose", "collision",
               "pointgoal_with_gps_compass")  # fmt: skip
    env = gymnasium.make(
        "SoundSpaces/AudioGoalContinuous-v0", data=data, scenes=SCENES, sensors=sensors, depth_size=16,
        rules=continuous.Rules(min_distance=2.0), gps_sigma=0.5, noises=("fan_0",), disable_env_checker=True,
    )  # fmt: skip
    check_env(env.unwrapped)


def test_vector_agrees_to_the_bit(data: nav.NavData) -> None:
    options: dict[str, Any] = {
        "scenes": SCENES, "sensors": HEARD, "rules": continuous.Rules(min_distance=2.0), "max_steps": 5,
    }  # fmt: skip
    many = ContinuousNavVectorEnv(2, data, **options)
    ones = [ContinuousNavEnv(data, **options) for _ in range(2)]
    heard, _ = many.reset(seed=4)
    firsts = [env.reset(seed=4 + i)[0] for i, env in enumerate(ones)]
    over = [False, False]
    for step in range(9):
        for i, one in enumerate(firsts):
            for name in HEARD:
                assert np.array_equal(heard[name][i], one[name]), (step, name)
        heard, rewards, ended, cut, _ = many.step(np.array([1, 1 + step % 3]))
        for i, env in enumerate(ones):
            if over[i]:
                firsts[i], over[i] = env.reset()[0], False
            else:
                firsts[i], reward, a, b, _ = env.step(1 if i == 0 else 1 + step % 3)
                assert reward == rewards[i] and (a, b) == (ended[i], cut[i])
                over[i] = a or b


def episode(**changes: Any) -> continuous.ContinuousEpisode:
    """In the ladder: from the lower corridor's first cell to the last one's, 5 m away in sight."""
    given: dict[str, Any] = {
        "episode_id": "own", "scene": "ladder", "start": (0.5, 0.5, 0.0), "heading": 0.0,
        "goals": (continuous.SoundSource("telephone", (5,)),), "distance": 5.0, "actions": 18,
    }  # fmt: skip
    return continuous.ContinuousEpisode(**{**given, **changes})


def walk(
    env: ContinuousNavEnv, what: continuous.ContinuousEpisode, steps: int
) -> tuple[float, dict[str, Any]]:
    """Straight on, then STOP: the sum of rewards, and `info`."""
    env.reset(seed=0, options={"episode": what})
    total = 0.0
    for _ in range(steps):
        total += env.step(1)[1]
    _, reward, terminated, _, info = env.step(0)
    assert terminated
    return total + reward, info


def test_measures_by_hand(data: nav.NavData) -> None:
    env = make(data)
    total, info = walk(env, episode(), 17)  # 4.25 of 5 m
    assert info["success"] == 1.0 and info["spl"] == 1.0 and info["sna"] == 1.0 and info["na"] == 18
    assert info["distance_to_goal"] == pytest.approx(0.75) and info["softspl"] == pytest.approx(0.85)
    assert total == pytest.approx(10.0 - 0.01 * 18 + 4.25)
    # 1 m away is not nearer than 1 m
    assert walk(env, episode(), 16)[1]["success"] == 0.0
    # A path of 4.25 m for a distance of 2: one that the episode states
    assert walk(env, episode(distance=2.0), 17)[1]["spl"] == pytest.approx(2.0 / 4.25)
    # silent from step 8 on; step 18 is the STOP. Offsets are rounded down to steps.
    short = (continuous.SoundSource("telephone", (5,), 0.0, 2.2),)
    assert walk(env, episode(goals=short), 17)[1]["success_when_silent"] == 1.0
    long = (continuous.SoundSource("telephone", (5,), 0.0, 4.75),)
    assert walk(env, episode(goals=long), 17)[1]["success_when_silent"] == 0.0
    # A distractor in the fourth cell, 0.25 m beyond which 13 steps end
    misled = episode(distractors=(continuous.SoundSource("telephone", (3,)),))
    _, info = walk(env, misled, 13)
    assert info["distractor_success"] == 1.0 and info["success"] == 0.0
    assert walk(env, misled, 17)[1]["distractor_success"] == 0.0
    # The nearest of several goals counts
    several = episode(
        goals=(continuous.SoundSource("telephone", (5,)), continuous.SoundSource("fan_0", (2,)))
    )
    assert walk(env, several, 8)[1]["success"] == 1.0


def test_sounds_begin_and_end(data: nav.NavData) -> None:
    env = make(data)
    goal = (continuous.SoundSource("telephone", (5,), 0.5, 1.0),)
    heard = [env.reset(seed=0, options={"episode": episode(goals=goal)})[0]["audiogoal"]]
    silent = [env.state.silent]  # type: ignore[union-attr]
    for _ in range(7):
        heard.append(env.step(2)[0]["audiogoal"])
        silent.append(env.state.silent)  # type: ignore[union-attr]
    assert silent == [True, True, False, False, True, True, True, True]
    level = [float(np.abs(h).max()) for h in heard]
    assert level[0] == 0.0 and level[1] < 1e-6 * max(level)  # the second is what transforms round
    # From 5 m away the first sound comes 14.6 ms later; the tail of .5 s rings out over two steps more, then nothing.
    first = int(np.argmax(np.abs(heard[2]).max(axis=0) > 0.05 * level[2]))
    assert abs(first - 5.0 / 343.0 * RATE) < 20
    assert min(level[2:5]) > 0.0 and level[7] < 1e-6 * max(level)


def test_a_moving_goal_comes_nearer(data: nav.NavData) -> None:
    """At 2 m/s along the corridor towards an agent at rest: after 1.5 s 3 m nearer."""
    env = make(data)
    goal = (continuous.SoundSource("telephone", (5, 4, 3, 2, 1, 0), speed=2.0),)
    env.reset(seed=0, options={"episode": episode(goals=goal)})
    for _ in range(6):
        env.step(2)
    assert env.state is not None
    assert env.state.distance == pytest.approx(2.0)
    for _ in range(4):  # at the agent's place after 2.5 s, then back
        env.step(2)
    assert env.state.distance == pytest.approx(0.0, abs=1e-9)
    for _ in range(2):
        env.step(2)
    assert env.state.distance == pytest.approx(1.0)


def test_a_moving_goal_stays_on_its_floor(data: nav.NavData, monkeypatch: pytest.MonkeyPatch) -> None:
    """Point 3 is above a table: no goal goes over it."""
    floor_of = ContinuousWorld.floor_of

    def raised(self: ContinuousWorld, point: int) -> Any:
        return self.floor_at(0.7) if point == 3 else floor_of(self, point)

    monkeypatch.setattr(ContinuousWorld, "floor_of", raised)
    env, routes = make(data, rules=continuous.Rules(min_distance=1.0, speed=1.0)), []
    for seed in range(30):
        env.reset(seed=seed)
        assert env.state is not None
        routes.append(env.state.episode.goals[0].route)
    assert any(len(route) > 2 for route in routes)
    assert not any(3 in route for route in routes)


def test_noise_has_its_level(data: nav.NavData) -> None:
    env = make(data, noises=("fan_0",), noise_db=20.0)
    goal = (continuous.SoundSource("telephone", (5,), 100.0),)
    env.reset(seed=0, options={"episode": episode(goals=goal, noise="fan_0")})
    heard = np.concatenate([env.step(2)[0]["audiogoal"] for _ in range(4)], axis=1)  # a clip
    rms = np.sqrt((heard.astype(float) ** 2).mean(axis=1))
    assert rms == pytest.approx(math.sqrt(1.0 / (4.0 * math.pi)) * 0.1, rel=1e-4)
    assert abs(np.corrcoef(heard)[0, 1]) < 0.2


def test_the_oracle_arrives(data: nav.NavData) -> None:
    result = nav.evaluate(continuous.ContinuousOracle(), make(data), drawn(data, 8))
    rows = result.rows
    assert rows["success"].min() == 1.0 and rows["spl"].min() > 0.97 and rows["sna"].min() == 1.0


def drawn(data: nav.NavData, count: int) -> list[continuous.ContinuousEpisode]:
    env, found = make(data), []
    for k in range(count):
        env.reset(seed=k)
        assert env.state is not None
        found.append(env.state.episode)
    return found


def test_the_map_shows_agent_and_goal_where_they_are(data: nav.NavData) -> None:
    """Made as Stable-Baselines3 makes environments; where the picture changes is where the agent went."""
    env = gymnasium.make(
        "SoundSpaces/AudioGoalContinuous-v0",
        data=data,
        scenes=SCENES,
        sensors=HEARD,
        render_mode="rgb_array",
    )
    env.reset(seed=3)
    first: Any = env.render()
    assert first.dtype == np.uint8 and first.ndim == 3 and first.shape[2] == 3 and first.std() > 10.0
    again: Any = env.render()
    assert np.array_equal(first, again)
    own = cast(ContinuousNavEnv, env.unwrapped)
    state = own.state
    assert state is not None
    while not state.over and state.path < 1.0:
        env.step(state.oracle_action())
    second: Any = env.render()
    axes = _page(own.setting.data.dataset(state.episode.scene).path, state.episode.goals[0].route[0]).map
    changed = (first != second).any(axis=2)
    changed[: round(len(first) - axes.get_window_extent().y1)] = False  # the title
    rows, columns = np.nonzero(changed)
    places = np.array([pose[:2] for pose in own.trail])
    pixels = axes.transData.transform(places)
    pixels[:, 1] = len(first) - pixels[:, 1]
    low, high = pixels.min(axis=0) - 20.0, pixels.max(axis=0) + 20.0  # a marker's reach
    assert (columns >= low[0]).all() and (columns <= high[0]).all()
    assert (rows >= low[1]).all() and (rows <= high[1]).all()
    assert np.linalg.norm([np.ptp(columns), np.ptp(rows)]) >= np.linalg.norm(pixels[-1] - pixels[0])


def test_bad_input(data: nav.NavData) -> None:
    for options, text in (
        ({"sensors": ("smell",)}, "unknown where poses are continuous"),
        ({"fade": 0.3}, "at most a step"),
        ({"paths": "exact"}, "simulated, moved, got 'exact'"),
        ({"forward": math.nan}, "forward: expected"),
        ({"max_steps": 0}, "max_steps"),
        ({"turn": 3}, "turn"),
        ({"step_time": 0.01, "fade": 0.005}, "256 samples"),
        ({"noises": ("nothing",)}, "sound 'nothing'"),
        ({"render_mode": "human"}, "render_mode"),
        ({"episodes": []}, "episodes: expected at least one"),
    ):
        with pytest.raises(ConfigError, match=text):
            make(data, **options)
    for rules, text in (
        ({"goals": 0}, "1 to 16 goals"),
        ({"onset": (2.0, 1.0)}, "rising bounds"),
        ({"speed": math.nan}, "speed"),
        ({"duration": (math.nan, 1.0)}, "duration"),
    ):
        with pytest.raises(ConfigError, match=text):
            continuous.Rules(**rules)
    env = make(data)
    for changes, kind, text in (
        ({"start": (0.05, 0.5, 0.0)}, PointError, "cannot stand"),
        ({"start": (2.5, 1.5, 0.0)}, PointError, "cannot stand"),
        ({"goals": (continuous.SoundSource("telephone", (99,)),)}, EpisodeError, "point 99"),
        ({"goals": (continuous.SoundSource("nothing", (1,)),)}, ConfigError, "sound 'nothing'"),
    ):
        with pytest.raises(kind, match=text):
            env.reset(options={"episode": episode(**changes)})
    for wrong in ({"start": (math.nan, 0.5, 0.0)}, {"goals": ()}):
        with pytest.raises(EpisodeError):
            episode(**wrong)
    bad: tuple[dict[str, Any], ...] = ({"onset": 2.0, "offset": 1.0}, {"speed": math.inf}, {"route": ()})
    for source in bad:
        with pytest.raises(EpisodeError):
            continuous.SoundSource(**{"sound": "telephone", "route": (1,), **source})
    with pytest.raises(gymnasium.error.ResetNeeded):
        make(data).step(1)
    env.reset(seed=0)
    with pytest.raises(gymnasium.error.InvalidAction):
        env.step(4)


def test_pickle_and_seeds(data: nav.NavData) -> None:
    env = make(data)
    again = pickle.loads(pickle.dumps(env))
    for one in (env, again):
        one.reset(seed=7)
    a, b = env.step(1)[0], again.step(1)[0]
    assert all(np.array_equal(a[name], b[name]) for name in a)
    assert env.state is not None and env.state.episode == again.state.episode


#: What its file for distractors says (`configs/savnce/*/mp3d/savnce_distractor.yaml`), as facts of the task.
SAVNCE: dict[str, Any] = {
    "ENVIRONMENT": {"MAX_EPISODE_STEPS": 500},
    "SIMULATOR": {
        "DEPTH_SENSOR": {"WIDTH": 128, "HEIGHT": 128},
        "STEP_TIME": 0.25, "FORWARD_STEP_SIZE": 0.25, "TURN_ANGLE": 15,
        "AUDIO": {"EVERLASTING": False, "HAS_DISTRACTOR_SOUND": True, "HAS_NOISE_SOUND": False, "MIC_TYPE": "binaural"},
    },
    "TASK": {
        "SENSORS": ["BINAURAL_FEATURE_EXTRACTOR", "POSE_SENSOR", "GOAL_DESCRIPTOR_SENSOR"],
        "MEASUREMENTS": ["SUCCESS", "SPL", "SUCCESS_WHEN_SILENT", "DISTRACTOR_SUCCESS"],
        "SUCCESS": {"SUCCESS_DISTANCE": 1.0},
    },
}  # fmt: skip


#: TASK.SENSORS of its 15 task files (`configs/savnce`, commit 9c7a1a3b1e of 2026-06-23), and which have no observation
#: of ours.
SAVNCE_SENSORS = (
    ("BINAURAL_FEATURE_EXTRACTOR POSE_SENSOR GOAL_DESCRIPTOR_SENSOR ORACLE_ACCDDOA_SENSOR",
     "GOAL_DESCRIPTOR_SENSOR ORACLE_ACCDDOA_SENSOR"),
    ("BINAURAL_FEATURE_EXTRACTOR POSE_SENSOR ORACLE_CATEGORY_SENSOR GOAL_DESCRIPTOR_SENSOR ORACLE_ACCDDOA_SENSOR",
     "ORACLE_CATEGORY_SENSOR GOAL_DESCRIPTOR_SENSOR ORACLE_ACCDDOA_SENSOR"),
    ("CATEGORY", "CATEGORY"),
    ("POINTGOAL_WITH_GPS_COMPASS_SENSOR", ""),
    ("POSE_SENSOR ORACLE_ACCDDOA_SENSOR", "ORACLE_ACCDDOA_SENSOR"),
    ("SPECTROGRAM_SENSOR", ""),
    ("SPECTROGRAM_SENSOR CATEGORY POINTGOAL_WITH_GPS_COMPASS_SENSOR POSE_SENSOR LOCATION_BELIEF CATEGORY_BELIEF",
     "CATEGORY LOCATION_BELIEF CATEGORY_BELIEF"),
    ("SPECTROGRAM_SENSOR CATEGORY POSE_SENSOR", "CATEGORY"),
    ("SPECTROGRAM_SENSOR POSE_SENSOR", ""),
    ("SPECTROGRAM_SENSOR POSE_SENSOR CATEGORY", "CATEGORY"),
)  # fmt: skip


@pytest.mark.parametrize(("sensors", "own"), SAVNCE_SENSORS)
def test_the_sensors_of_savnces_task_files_are_read_and_its_own_named(sensors: str, own: str) -> None:
    config = {**SAVNCE, "TASK": {**SAVNCE["TASK"], "SENSORS": sensors.split()}}
    assert savnce_own_sensors(config) == tuple(own.split())
    ours = savnce_options(config)["sensors"]
    assert ("spectrogram" in ours) == ("SPECTROGRAM" in sensors) and ("pose" in ours) == (
        "POSE" in sensors
    )
    assert len(ours) == 1 + len(sensors.split()) - len(own.split())  # depth, and what is not its own
    with pytest.raises(ConfigError, match="no sensor 'CATEGORIES'"):
        savnce_own_sensors({"TASK": {"SENSORS": ["CATEGORIES"]}})


def test_savnces_configuration_runs(data: nav.NavData) -> None:
    options = savnce_options(SAVNCE)
    env = ContinuousNavEnv(data, scenes=SCENES, **{**options, "depth_size": 32})
    task = env.setting.task
    assert (task.step_time, task.forward, task.turn_deg, task.success_distance) == (
        0.25,
        0.25,
        15.0,
        1.0,
    )
    observation, info = env.reset(seed=1)
    assert observation["interaural"].shape == (4, 256, 26) and observation["pose"].shape == (4,)
    assert env.state is not None and len(env.state.episode.distractors) == 1
    while not env.state.over:
        observation, _, _, _, info = env.step(env.state.oracle_action())
    assert info["success"] == 1.0
    broken = {**SAVNCE, "TASK": {"SENSORS": ["EGO_MAP"]}}
    with pytest.raises(ConfigError, match="no sensor 'EGO_MAP'"):
        savnce_options(broken)
    with pytest.raises(ConfigError, match="binaural"):
        savnce_options({"SIMULATOR": {"AUDIO": {"MIC_TYPE": "mono"}}})


def test_interaural_features_by_hand() -> None:
    """A tone in the middle of bin 32, a quarter period later and half as loud at the right ear."""
    t = np.arange(4000) * 2.0 * math.pi * 32.0 / 512.0
    found = interaural(np.stack([np.sin(t), 0.5 * np.sin(t - 0.5 * math.pi)]).astype(np.float32), RATE)
    tone = found[:, 31, 5:20]  # bins from the first on
    assert found.shape == (4, 256, 26)
    assert tone[0] == pytest.approx(0.75 * 128.0, rel=1e-3)  # half of the Hann window's sum of 256
    assert tone[1] == pytest.approx(0.0, abs=1e-3) and tone[2] == pytest.approx(1.0, abs=1e-3)
    assert tone[3] == pytest.approx(math.log10(2.0), abs=1e-3)


def test_direction_of_arrival() -> None:
    """A white wave 5 samples earlier at the left ear; Woodworth's sphere and back."""
    wave = np.random.default_rng(0).standard_normal(4005)
    delay, peak = interaural_delay(np.stack([wave[5:], wave[:-5]]), RATE)
    assert delay == pytest.approx(5.0 / RATE, abs=0.1 / RATE) and peak > 0.9
    noise = np.random.default_rng(1).standard_normal((2, 4000))
    assert interaural_delay(noise, RATE)[1] < 0.12
    for degrees in (-80.0, -20.0, 0.0, 45.0):
        angle = math.radians(degrees)
        assert direction_of(EAR_S * (angle + math.sin(angle))) == pytest.approx(angle, abs=1e-9)
