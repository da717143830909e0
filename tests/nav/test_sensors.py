"""What agents see, hear and are told: closed forms, statistics, bad input."""

from __future__ import annotations

import os
import pickle
import shutil
from pathlib import Path
from types import SimpleNamespace
from typing import Any, get_args

import numpy as np
import pytest
import soundfile
from scipy.signal import fftconvolve

import soundspaces_sim as ss
from soundspaces_sim.nav.audio_sensor import (
    AudioSensor,
    Cache,
    add_noise,
    bake_sound,
    intensity,
    picture,
    through,
)
from soundspaces_sim.nav.data import NavData
from soundspaces_sim.nav.depth import depth_views, scene_of_dataset
from soundspaces_sim.nav.episode_state import EpisodeState
from soundspaces_sim.nav.episodes import make_episode
from soundspaces_sim.nav.navigation_graph import FORWARD
from soundspaces_sim.nav.sensor_table import pointgoal
from soundspaces_sim.nav.sensors import SensorSuite
from soundspaces_sim.nav.sounds import SoundBank
from soundspaces_sim.nav.task import POINTGOAL, TaskOptions
from soundspaces_sim.nav.views import Views, bake_views, normalise, shrink
from tests.marks import ci_slow
from tests.nav.conftest import T_CORRIDOR, lattice_dataset, lattice_scene
from tests.rooms import box, table
from tests.stats import limit

RATE = 16000
JUNCTION = T_CORRIDOR.index((3, 3))


# Seeing


@pytest.mark.parametrize("heading", [0, 90, 180, 270])
def test_depth_of_an_empty_box_is_the_distance_of_planes(heading: int) -> None:
    """Each pixel is the nearest of the planes ahead, at the sides, above, below, by its ray (1, left, up)."""
    size = np.array([6.0, 4.0, 3.0])
    camera = np.array([2.0, 1.5, 1.25])
    got = depth_views(box(tuple(size), table(0.1, 0.1)), camera, np.array([heading]), 32)[0, 0]
    a = np.deg2rad(heading)
    u = 1.0 - (2.0 * np.arange(32) + 1.0) / 32
    up, left = np.meshgrid(u, u, indexing="ij")
    rays = np.stack([np.cos(a) - np.sin(a) * left, np.sin(a) + np.cos(a) * left, up], axis=2)
    with np.errstate(divide="ignore"):
        t = np.where(rays > 0, (size - camera) / rays, -camera / rays)
    np.testing.assert_allclose(got, t.min(axis=2), atol=1e-4)


def test_depth_of_a_hole_is_zero_and_far_is_one() -> None:
    scene = box((30.0, 4.0, 3.0), table(0.1, 0.1))
    no_end = ss.Scene(
        scene.vertices, scene.faces[2:], scene.face_material[2:], scene.materials
    )  # -x is open
    views = normalise(depth_views(no_end, np.array([2.0, 2.0, 1.25]), np.array([0, 180]), 33)[0])
    assert views[0, 16, 16] == 1.0  # 28 m to the wall
    assert views[1, 16, 16] == 0.0  # nothing
    assert views[1, 32, 16] == pytest.approx(
        1.25 / 10 * 33 / 32, rel=1e-3
    )  # the floor's edge of the picture


def test_smaller_pictures_are_means_of_areas() -> None:
    big = np.arange(16.0).reshape(1, 4, 4)
    np.testing.assert_array_equal(shrink(big, 2)[0], [[2.5, 4.5], [10.5, 12.5]])
    assert shrink(big, 4) is big


@pytest.fixture(scope="module")
def baked(tmp_path_factory: pytest.TempPathFactory) -> NavData:
    """A corner of three cells with views and one goal's telephone baked."""
    root = tmp_path_factory.mktemp("baked")
    cells = [(0, 0), (1, 0), (1, 1)]
    lattice_dataset(cells, root, "corner")
    data = NavData(root)
    ds = data.dataset("corner")
    bake_views(ds, 128, lattice_scene(cells, "corner"))
    bake_sound(ds, SoundBank(RATE), "telephone", [2])
    return data


def test_baked_views_are_those_of_the_scene(baked: NavData, tmp_path: Path) -> None:
    ds = baked.dataset("corner")
    scene = lattice_scene([(0, 0), (1, 0), (1, 1)], "corner")
    direct = normalise(
        depth_views(scene, ds.points[1] - [0, 0, 0.25], np.array([0, 90, 180, 270]), 128)[0]
    )
    np.testing.assert_array_equal(Views(ds, 128).at(1), direct)
    np.testing.assert_array_equal(Views(ds, 32).at(1), shrink(direct, 32))
    with pytest.raises(ss.DatasetError, match="views of another scene"):
        bake_views(ds, 64 + 1, lattice_scene([(0, 0), (1, 0)], "corner"))
    other = tmp_path / "corner"
    shutil.copytree(ds.path, other)
    other_ds = ss.open_dataset(lattice_dataset([(0, 0), (0, 1), (0, 2)], tmp_path / "new", "corner"))
    shutil.copy(ds.path / "views.h5", other_ds.path / "views.h5")
    with pytest.raises(ss.DatasetError, match="views of another scene; delete"):
        Views(other_ds, 128)


def test_a_scene_that_cannot_be_loaded_is_said(data: NavData) -> None:
    with pytest.raises(ss.DatasetError, match=r"cannot be loaded.*nav bake"):
        Views(data.dataset("tee"), 32).at(0)


# Hearing


@ci_slow
def test_the_ear_on_the_side_of_the_source_is_louder(tmp_path: Path) -> None:
    """At the junction of a T, facing along the stem: white noise in the left arm is more than 3 dB louder at the
    left ear, in the right arm at the right one, in 40 of 40 draws of the noise."""
    ds = ss.open_dataset(lattice_dataset(T_CORRIDOR, tmp_path, "tee", walks=500))
    for variant, sign in (((1, 3), 1.0), ((5, 3), -1.0)):  # facing +Y, -X is to the left
        response = ds.binaurals(T_CORRIDOR.index(variant), JUNCTION, [(90.0, 0.0, 0.0)])
        for seed in range(40):
            noise = np.random.default_rng(seed).standard_normal(RATE).astype(np.float32)
            left, right = intensity(through(noise, response, 0, RATE)[0])
            assert sign * 20 * np.log10(left / right) > 3.0
    # Bells have few partials, whose levels at the ears differ by chance: 95 % of cases, from all places in the arms.
    bank, right_ones = SoundBank(RATE), []
    bells = [name for name in bank if name == "telephone" or name.startswith("ring_")]
    for place in (0, 1, 2, 4, 5, 6):
        response = ds.binaurals(T_CORRIDOR.index((place, 3)), JUNCTION, [(90.0, 0.0, 0.0)])
        for name in bells:
            left, right = intensity(through(bank[name], response, 0, RATE)[0])
            right_ones.append((left > right) == (place < 3))
    assert len(right_ones) == 36 and np.mean(right_ones) >= 0.95


def test_first_second_of_a_convolution(data: NavData) -> None:
    ds, bank = data.dataset("tee"), SoundBank(RATE)
    heard = AudioSensor(ds, bank, frozenset(("audiogoal",))).block("telephone", 0, JUNCTION)["audiogoal"]
    for k, heading in enumerate((0, 90, 180, 270)):
        response = ds.binaural(0, JUNCTION, heading)
        whole = np.stack([fftconvolve(bank["telephone"], ear) for ear in response])
        np.testing.assert_allclose(heard[k], whole[:, :RATE], atol=1e-5 * np.abs(whole).max())


def test_longer_sounds_play_on_with_their_tails(data: NavData, tmp_path: Path) -> None:
    """Second k of clip ∗ response; the first has no tail, also when the clip begins again; cached or not."""
    rng = np.random.default_rng(1)
    clip = (0.1 * rng.standard_normal(int(2.6 * RATE))).astype(np.float32)
    soundfile.write(tmp_path / "long.wav", clip, RATE, "FLOAT")
    ds, bank = data.dataset("tee"), SoundBank(RATE, tmp_path)
    whole = np.stack([fftconvolve(bank["long"], ear) for ear in ds.binaural(0, JUNCTION, 0.0)])
    made = {}
    caches: tuple[Cache, ...] = ("memory", "none")
    for cache in caches:
        audio = AudioSensor(ds, bank, frozenset(("audiogoal", "spectrogram")), cache)
        assert audio.seconds("long") == 2
        steps = [audio.block("long", 0, JUNCTION, t) for t in range(4)]
        for t, second in enumerate((0, 1, 0, 1)):
            expected = whole[:, second * RATE : (second + 1) * RATE]
            np.testing.assert_allclose(
                steps[t]["audiogoal"][0], expected, atol=2e-5 * np.abs(whole).max()
            )
        assert (steps[0]["spectrogram"] != steps[1]["spectrogram"]).any()
        np.testing.assert_array_equal(steps[0]["spectrogram"], steps[2]["spectrogram"])
        made[cache] = steps
    for a, b in zip(made["memory"], made["none"], strict=True):
        np.testing.assert_array_equal(a["spectrogram"], b["spectrogram"])


def test_caches_agree_to_the_bit(baked: NavData) -> None:
    ds, bank, kinds = baked.dataset("corner"), SoundBank(RATE), frozenset(("spectrogram", "intensity"))
    blocks = {c: AudioSensor(ds, bank, kinds, c).block("telephone", 2, 0) for c in get_args(Cache)}
    for name in kinds:
        np.testing.assert_array_equal(blocks["disk"][name], blocks["none"][name])
        np.testing.assert_array_equal(blocks["memory"][name], blocks["none"][name])
    assert isinstance(blocks["disk"]["spectrogram"].base, np.memmap | np.ndarray)
    for cache in get_args(Cache):  # without a cache one heading is made, not four
        audio = AudioSensor(ds, bank, kinds, cache)
        for way in range(4):
            one = audio.facing(way, "telephone", 2, 0)
            for name in kinds:
                np.testing.assert_array_equal(one[name], blocks["none"][name][way])
    # what was not baked is made
    np.testing.assert_array_equal(
        AudioSensor(ds, bank, kinds, "disk").block("telephone", 1, 0)["intensity"],
        AudioSensor(ds, bank, kinds, "none").block("telephone", 1, 0)["intensity"],
    )


def test_what_was_baked_of_another_sound_is_refused(baked: NavData, tmp_path: Path) -> None:
    folder = tmp_path / "corner"
    shutil.copytree(baked.dataset("corner").path, folder)
    (folder / "heard_telephone.h5").rename(folder / "heard_bell_0.h5")
    audio = AudioSensor(ss.open_dataset(folder), SoundBank(RATE), frozenset(("spectrogram",)))
    with pytest.raises(ss.DatasetError, match="observations of 'bell_0' of another sound"):
        audio.block("bell_0", 2, 0)


def test_what_another_renderer_makes_is_kept_apart(baked: NavData, tmp_path: Path) -> None:
    """Baked with two renderers beside one dataset, in either order: each finds its own, to the bit."""
    folder = tmp_path / "corner"
    shutil.copytree(baked.dataset("corner").path, folder)
    bank, kinds = SoundBank(RATE), frozenset(("intensity", "spectrogram"))
    own, direct = NavData(tmp_path), NavData(tmp_path, "direct")
    again = pickle.loads(pickle.dumps(direct))
    assert again.renderer == "direct" and again.dataset("corner").renderer == "direct"
    path = bake_sound(direct.dataset("corner"), bank, "telephone", [2])
    assert path.name == "heard_telephone.direct.h5"
    heard = {}
    for name, data in (("own", own), ("direct", again)):
        blocks = {
            c: AudioSensor(data.dataset("corner"), bank, kinds, c).block("telephone", 2, 0)
            for c in get_args(Cache)
        }
        for cache in blocks:
            np.testing.assert_array_equal(blocks[cache]["spectrogram"], blocks["none"]["spectrogram"])
        heard[name] = blocks["none"]["intensity"]
    assert (heard["direct"] < heard["own"]).any()
    with pytest.raises(ss.ConfigError, match=r"renderer.*'dircet'"):
        NavData(tmp_path, "dircet")


def test_noise_of_ears_has_its_level() -> None:
    rng = np.random.default_rng(0)
    ears = np.outer([1.0, 0.5], np.sin(np.arange(RATE))).astype(np.float32)
    rms = np.sqrt(np.mean(ears.astype(float) ** 2))
    power = np.array(
        [np.mean((add_noise(ears, 20.0, rng) - ears).astype(float) ** 2) for _ in range(60)]
    )
    z = (power.mean() / (rms**2 / 100.0) - 1.0) / (np.sqrt(2.0 / (2 * RATE)) / np.sqrt(len(power)))
    assert abs(z) < limit(1)


def test_spectrogram_is_that_of_the_reader(data: NavData) -> None:
    ds, bank = data.dataset("tee"), SoundBank(RATE)
    block = AudioSensor(ds, bank, frozenset(("spectrogram",))).block("telephone", 2, 5)
    expected = ds.spectrogram(bank["telephone"], 2, 5, 90.0)
    assert block["spectrogram"].shape == (4, 65, 26, 2) and expected.shape == (65, 26, 2)
    np.testing.assert_allclose(block["spectrogram"][1], expected, rtol=2e-3, atol=2e-3)
    assert picture(np.zeros((2, 44100), np.float32), 44100).shape == (65, 69, 2)


# Being told


def test_direction_and_distance_of_the_goal(data: NavData) -> None:
    tee = data.graph("tee")
    state = EpisodeState(
        tee,
        make_episode(tee, "0", T_CORRIDOR.index((3, 0)), 90, T_CORRIDOR.index((1, 3)), "telephone"),
        TaskOptions(),
    )
    rng = np.random.default_rng(0)
    distance, angle = pointgoal(state, 0.0, rng)
    assert distance == pytest.approx(np.sqrt(13)) and angle == pytest.approx(
        np.arctan2(2, 3)
    )  # left: positive
    for turn, expected in (
        (2, np.arctan2(2, 3) - np.pi / 2),
        (3, np.arctan2(2, 3)),
        (3, np.arctan2(2, 3) + np.pi / 2),
    ):
        state.move(turn)
        assert pointgoal(state, 0.0, rng)[1] == pytest.approx(expected)


def test_noise_of_the_gps_has_its_deviation(data: NavData) -> None:
    tee = data.graph("tee")
    state = EpisodeState(tee, make_episode(tee, "0", 0, 0, JUNCTION, "telephone"), TaskOptions())
    rng, n = np.random.default_rng(2), 4000
    polar = np.array([pointgoal(state, 0.5, rng) for _ in range(n)])
    offset = polar[:, :1] * np.stack([np.cos(polar[:, 1]), np.sin(polar[:, 1])], axis=1) - [3.0, 0.0]
    z_mean = offset.mean(axis=0) / (0.5 / np.sqrt(n))
    z_variance = (offset.var(axis=0) / 0.25 - 1.0) / np.sqrt(2.0 / n)
    correlation = np.corrcoef(offset.T)[0, 1] * np.sqrt(n)
    assert np.all(np.abs([*z_mean, *z_variance, correlation]) < limit(5))


def test_collisions_are_felt(data: NavData) -> None:
    tee = data.graph("tee")
    task = TaskOptions(task="PointGoal", sensors=(POINTGOAL, "collision"))
    sensor_suite = SensorSuite(data, SoundBank(RATE), task)
    state = EpisodeState(tee, make_episode(tee, "0", 0, 180, JUNCTION, "telephone"), task)
    out = sensor_suite.empty()
    state.move(FORWARD)
    sensor_suite.observe(state, np.random.default_rng(0), out)
    assert (
        out["collision"][0] == 1.0
        and state.collisions == 1
        and out[POINTGOAL].tolist() == [3.0, pytest.approx(np.pi)]
    )


# Sounds


def test_bank_of_formulas() -> None:
    bank = SoundBank(RATE)
    assert len(bank) == 102 and {s: len(n) for s, n in bank.splits.items()} == {
        "train": 73,
        "val": 11,
        "test": 18,
    }
    families = {split: {n.rsplit("_", 1)[0] for n in names} for split, names in bank.splits.items()}
    assert not families["train"] & families["test"] and not families["train"] & families["val"]
    for name in bank:
        sound = bank[name]
        assert sound.shape == (RATE,) and np.sqrt(np.mean(sound.astype(float) ** 2)) == pytest.approx(
            1.0, abs=1e-5
        )
    digests = {bank.digest(name) for name in bank}
    assert len(digests) == 102
    assert SoundBank(RATE)["water_3"].tobytes() == bank["water_3"].tobytes()


def test_sounds_of_a_folder(tmp_path: Path) -> None:
    t = np.arange(22050) / 44100
    tone = np.sin(2 * np.pi * 1000 * t)
    soundfile.write(tmp_path / "tone.flac", np.stack([tone, np.zeros_like(tone)], axis=1), 44100)
    for k in range(9):
        soundfile.write(tmp_path / f"s{k}.wav", np.sin(0.1 * (k + 1) * np.arange(RATE)), RATE)
    bank = SoundBank(RATE, tmp_path)
    assert bank["tone"].shape == (RATE,)  # half a second, then silence
    assert not bank["tone"][9000:].any()
    spectrum = np.abs(np.fft.rfft(bank["tone"][:8000]))
    assert spectrum.argmax() == 500
    assert sorted(n for names in bank.splits.values() for n in names) == sorted(bank)
    (tmp_path / "sounds.toml").write_text('test = ["tone"]')
    assert SoundBank(RATE, tmp_path).names("test") == ("tone",)


@pytest.mark.parametrize(
    ("samples", "message"),
    [(np.zeros(100), "silent"), (np.zeros(0), "empty"), (np.array([0.5, np.nan]), "not finite")],
)
def test_bad_sounds(tmp_path: Path, samples: np.ndarray, message: str) -> None:
    soundfile.write(tmp_path / "bad.wav", samples, RATE, "FLOAT")
    with pytest.raises(ss.ConfigError, match=rf"bad\.wav: this sound .*{message}"):
        SoundBank(RATE, tmp_path)["bad"]
    with pytest.raises(ss.ConfigError, match="did you mean 'telephone'"):
        SoundBank(RATE).check("telefone")


def test_a_bank_with_a_fifo_or_a_device(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.wav")
    (tmp_path / "zeros.wav").symlink_to("/dev/zero")
    bank = SoundBank(RATE, tmp_path)
    for name in ("pipe", "zeros"):
        with pytest.raises(ss.ConfigError, match=r"cannot read this sound: it is not a regular file"):
            bank[name]


def test_a_sound_of_more_samples_than_are_taken(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    soundfile.write(tmp_path / "many.wav", np.ones((2000, 8)), RATE)
    monkeypatch.setattr("soundspaces_sim.core.io.sound.MOST_SAMPLES", 10_000)
    with pytest.raises(
        ss.ConfigError, match=r"2,000 samples of 8 channels are too many; at most 10,000"
    ):
        SoundBank(RATE, tmp_path)["many"]


def test_the_scene_of_a_dataset_among_several() -> None:
    """One command makes datasets of several scenes: each is of its own."""
    scene = ss.load_scene("home-1")
    manifest = SimpleNamespace(
        command="soundspaces-sim rirs home-0 home-1 --spacing 1 --out data", scene_digest=scene.digest
    )
    ds: Any = SimpleNamespace(scene="home-1", manifest=manifest, path="data/home-1")
    assert scene_of_dataset(ds).digest == scene.digest
