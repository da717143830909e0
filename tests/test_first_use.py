"""What a newcomer gives that is nearly right: it works, or the message says what to give."""

from __future__ import annotations

import logging
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import soundspaces_sim as ss
from soundspaces_sim.core.config import DatasetConfig
from soundspaces_sim.rendering.auralise import as_mono
from tests.rooms import plain, table, two_rooms


def test_a_room_in_centimetres_is_refused_and_a_vast_one_doubted(
    caplog: pytest.LogCaptureFixture,
) -> None:
    with pytest.raises(ss.SceneError, match=r"600 x 500 x 270 m is no room.*cm by 100"):
        ss.shoebox((600, 500, 270))
    with caplog.at_level(logging.WARNING):
        ss.shoebox((90.0, 60.0, 40.0))
        assert "are the lengths in m?" in caplog.text
        caplog.clear()
        ss.shoebox((90.0, 60.0, 25.0))
    assert not caplog.text


def test_silence_is_warned_of(caplog: pytest.LogCaptureFixture) -> None:
    sealed = two_rooms(table(0.2, 0.5), door=False)
    config = plain(walks=16, duration=0.1, radiance_transfer=False)
    with caplog.at_level(logging.WARNING):
        ss.simulate(sealed, [[1.0, 1.0, 1.0]], [[7.0, 1.0, 1.0]], config)
    assert "no sound arrives" in caplog.text and "unit" in caplog.text


def test_absorption_at_frequencies_and_of_walls() -> None:
    def of(scene: ss.Scene, face: int) -> np.ndarray:
        bands = (110.0, 140.0, 450.0, 550.0, 3900.0, 4100.0)
        return scene.materials.in_bands(bands)[0][scene.face_material[face], ::2]

    room = ss.shoebox((6.0, 5.0, 3.0), absorption={125: 0.1, 500: 0.2, 4000: 0.6})
    for face in range(12):
        np.testing.assert_allclose(of(room, face), [0.1, 0.2, 0.6], atol=0.01)
    walls: dict[str, Any] = dict.fromkeys(("west", "east", "south", "north", "ceiling"), 0.3)
    mixed = ss.shoebox((6.0, 5.0, 3.0), absorption={**walls, "floor": {125: 0.1, 4000: 0.6}})
    floor = np.flatnonzero((mixed.corners[:, :, 2] == 0.0).all(axis=1))
    np.testing.assert_allclose(of(mixed, int(floor[0]))[[0, 2]], [0.1, 0.6], atol=0.01)
    np.testing.assert_allclose(of(mixed, 0), 0.3, atol=1e-9)
    for six in ([0.1] * 6, np.full(6, 0.1)):
        with pytest.raises(ss.MaterialError, match=r"absorption: got 6 values.*'west'.*125"):
            ss.shoebox((6.0, 5.0, 3.0), absorption=six)  # type: ignore[arg-type]
    for wrong in ({125: 1.5}, {125: "much"}, {-1: 0.1}, {np.nan: 0.1}, {125: np.nan}):
        with pytest.raises(ss.MaterialError):
            ss.shoebox((6.0, 5.0, 3.0), absorption=wrong)  # type: ignore[arg-type]


@pytest.mark.parametrize(("dtype", "full"), [(np.int16, 2**15), (np.int32, 2**31), (np.uint8, 2**7)])
def test_whole_samples_are_shares_of_full_scale(dtype: type, full: float) -> None:
    sound = np.array([-0.5, 0.0, 0.25])
    offset = full if dtype == np.uint8 else 0
    given: np.ndarray = (sound * full + offset).astype(dtype)
    np.testing.assert_allclose(as_mono(given), sound, atol=1e-7)
    np.testing.assert_array_equal(as_mono([1, 0, 0]), [1.0, 0.0, 0.0])  # a pulse


def test_several_headings_are_told_where_to_go(dataset_folder: Path) -> None:
    with ss.open_dataset(dataset_folder) as ds:
        calls: list[Any] = [
            ds.binaural,
            lambda s, l, heading_deg: ds.render([1.0], s, l, heading_deg),
        ]
        for call in calls:
            with pytest.raises(ss.ConfigError, match=r"heading_deg: expected one angle.*binaurals"):
                call(0, 1, heading_deg=[0, 90])


def test_a_shard_names_its_dataset(dataset_folder: Path, tmp_path: Path) -> None:
    shard = next(dataset_folder.glob("s*.h5"))
    with pytest.raises(
        ss.DatasetError, match=f"a file of the dataset {dataset_folder}: open that folder"
    ):
        ss.open_dataset(shard)
    (tmp_path / "x.h5").write_text("")
    with pytest.raises(ss.DatasetError, match="a dataset is a folder"):
        ss.open_dataset(tmp_path / "x.h5")


def test_settings_that_clash_are_told_first() -> None:
    with pytest.raises(ss.ConfigError, match=r"dataset\.store.*simulation\.materials"):
        ss.JobConfig(
            simulation=ss.SimulationConfig(materials=True),  # type: ignore[arg-type]
            dataset=DatasetConfig(store="waveform"),
        )
    with pytest.raises(ss.ConfigError, match=r"simulation\.walks.*max_walks"):
        ss.SimulationConfig(target_error=0.05, walks=5000, max_walks=1000)
