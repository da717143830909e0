"""Other materials on reading: a dataset with counts, its echograms, table, waveforms and refusals."""

import pickle
from collections.abc import Iterator
from pathlib import Path

import h5py
import numpy as np
import pytest

import soundspaces_sim as ss
from soundspaces_sim.core.config import DatasetConfig
from soundspaces_sim.core.errors import DatasetError, MaterialError
from soundspaces_sim.dataset.format.echogram_shard import EchogramShard
from soundspaces_sim.dataset.format.writing import encode_echograms
from soundspaces_sim.echogram.closure import change
from soundspaces_sim.echogram.measures import room_measures
from soundspaces_sim.echogram.reflection_counts import MOST_DISPERSION
from soundspaces_sim.echogram.refurnish import Materials
from tests.rooms import box, plain, table

POINTS = [[1.0, 1.2, 1.1], [3.9, 1.1, 1.6], [3.2, 3.1, 0.9]]
GOLDEN = Path(__file__).resolve().parents[1] / "golden" / "echogram-7"
CHANGE: Materials = {"m0": 0.3, "m3": [0.1, 0.15, 0.2, 0.25]}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    room = box((5.0, 4.0, 3.0), table([0.2, 0.1, 0.15, 0.12, 0.2, 0.12], [0.5] * 6), range(6))
    job = ss.JobConfig(
        simulation=plain(walks=64, duration=0.3, materials=True),
        dataset=DatasetConfig(store="both", rate=8000, headings=(0.0,)),
    )
    return ss.build_dataset(room, tmp_path_factory.mktemp("m"), job, points=np.array(POINTS)).folder


@pytest.fixture
def plainly(folder: Path) -> Iterator[ss.RirDataset]:
    with ss.open_dataset(folder) as ds:
        yield ds


def test_every_way_of_reading_follows(folder: Path, plainly: ss.RirDataset) -> None:
    with ss.open_dataset(folder, materials=CHANGE) as ds:
        here, there = plainly.echogram(0, 1, materials=CHANGE), ds.echogram(0, 1)
        np.testing.assert_array_equal(here.energy, there.energy)
        assert here.energy[:, 0].sum() < plainly[0, 1].energy[:, 0].sum()
        assert (there.relative_error >= plainly[0, 1].relative_error).all()
        row = ds.table()[0]
        found = room_measures(ds.echogram(int(row["source"]), int(row["listener"])))
        assert row["c50_1"] == np.float32(found.c50[1]) and row["c50_1"] > plainly.table()[0]["c50_1"]
        assert row["c50_error_1"] > plainly.table()[0]["c50_error_1"]
        assert row["early_error_0"] > plainly.table()[0]["early_error_0"]
        quieter = (ds.ambisonic(0, 1) ** 2).sum() / (plainly.ambisonic(0, 1) ** 2).sum()
        of_energy = sum(np.sum(e.histogram()) for e in (there,)) / np.sum(plainly[0, 1].histogram())
        assert quieter == pytest.approx(of_energy, rel=0.25) and of_energy < 0.95
        again = pickle.loads(pickle.dumps(ds))
        np.testing.assert_array_equal(again.echogram(0, 1).energy, there.energy)
        again.close()


def test_the_materials_of_a_dataset(plainly: ss.RirDataset) -> None:
    """Those of which reflections were counted; at either end of a range the closure is still within bounds."""
    assert {m.name for m in plainly.materials} == {f"m{i}" for i in range(6)}
    assert sum(m.share for m in plainly.materials) == pytest.approx(1.0)
    first = plainly.materials.named("m4")
    np.testing.assert_allclose(first.absorption, 0.2, atol=1e-9)
    assert (first.lowest < first.absorption).all() and (first.absorption < first.highest).all()
    for ends in (first.lowest, first.highest):
        plainly.echogram(0, 1, materials={"m4": ends.tolist()})
    assert "% of reflections" in repr(plainly.materials)
    with pytest.raises(MaterialError, match="no counts of 'x'; there are: m"):
        plainly.materials.named("x")


def test_what_is_refused(folder: Path, dataset_folder: Path) -> None:
    with pytest.raises(MaterialError, match="by 'marble' were not counted"):
        ss.open_dataset(folder, materials={"marble": 0.5})
    with ss.open_dataset(folder, materials={"m4": 0.995}) as ds:
        with pytest.raises(MaterialError, match=r"'m4' changes too much.*simulate anew"):
            ds.echogram(0, 1)
        with pytest.raises(MaterialError, match="'m4' changes too much"):
            ds.table()
    with ss.open_dataset(folder, materials={"m4": 0.995}, force=True) as ds:
        assert ds.echogram(0, 1).energy.max() > 0.0
    with pytest.raises(DatasetError, match=r"holds no counts of reflections.*enabled = true"):
        ss.open_dataset(dataset_folder, materials={"m0": 0.1})
    with ss.open_dataset(dataset_folder) as ds:
        assert len(ds.materials) == 0 and repr(ds.materials) == "no materials were counted"


def _attributes() -> dict[str, object]:
    names = ("key", "scene", "scene_digest", "config", "code_version", "licence", "citation")
    return {**dict.fromkeys(names, "x"), "seed": 0, "speed_of_sound": 343.0}


def test_counts_of_version_7_are_read_as_they_are() -> None:
    """They hold what doubled absorption takes, here 2/3; the
    closure is exact there: n ln(1 - (k - 1) z) / (1 - k), of one material."""
    z = -2.0 / 3.0
    shard = EchogramShard(next(GOLDEN.glob("s*.h5")))
    counts = shard.echogram(0, 1, counts=True).counts
    shard.close()
    assert counts is not None and len(counts.groups.names) == 1 and np.allclose(counts.groups.anchor, z)
    found, k = change(counts, np.full((1, 4), np.log1p(z))).nepers, counts.anchored[:, 0]
    expected = counts.mean[:, 0] * np.log1p(-z * (k - 1.0)) / (1.0 - k)
    np.testing.assert_allclose(found, expected, rtol=1e-6)
    with ss.open_dataset(GOLDEN, materials={counts.groups.names[0]: 0.45}) as ds:
        assert ds.echogram(0, 1).energy[:, 0].sum() > 0.0


def test_counts_are_stored_as_they_are() -> None:
    """Means to half a step of their code, sqrt(n / peak) in 255 steps; variances over means to half of theirs, sqrt(κ / 40), correlations to half a 127th; times as they are."""
    room = box((5.0, 4.0, 3.0), table([0.2, 0.1], [0.5] * 2), [0, 1, 0, 1, 0, 1])
    points = np.array(POINTS)
    made = ss.simulate(room, points, points, plain(walks=32, duration=0.2, materials=True))
    assert made.counts is not None
    shard = EchogramShard(encode_echograms(made, np.arange(3), np.arange(3), _attributes()))
    found = shard.echogram(0, 2, counts=True)
    assert found.counts is not None and shard.echogram(0, 2).counts is None
    expected = made.counts.pairs(0, 2)
    peak = expected.mean.max(axis=0)
    off = np.abs(np.sqrt(found.counts.mean / peak) - np.sqrt(expected.mean / peak))
    assert off.max() < 0.5 / 255.0 + 1e-6
    for name in ("dispersion", "anchored"):
        steps = 255.0 * np.sqrt(getattr(found.counts, name) / MOST_DISPERSION)
        wanted = 255.0 * np.sqrt(np.minimum(getattr(expected, name) / MOST_DISPERSION, 1.0))
        assert np.abs(steps - wanted).max() < 0.5 + 1e-3
    assert np.abs(found.counts.correlation - expected.correlation).max() < 0.5 / 127.0 + 1e-6
    np.testing.assert_array_equal(found.counts.time, expected.time)
    np.testing.assert_array_equal(found.early.groups, made[0, 2].early.groups)
    assert found.counts.groups.names == made.counts.groups.names
    shard.close()


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        ("count_peak", np.nan, "'count_peak' holds values that cannot be"),
        ("count_time", -1.0, "'count_time' holds values that cannot be"),
        ("count_correlation", -128, "'count_correlation' holds values that cannot be"),
        ("group_absorption", np.nan, "'group_absorption' holds values that cannot be"),
        ("group_transmission", 1.0, "'group_absorption' holds values that cannot be"),
        ("group_anchor", np.nan, "'group_anchor' holds values that cannot be"),
        ("early_groups", 9, "'early_groups' holds values that cannot be"),
        ("group_names", '["a"]', "'group_absorption' holds values that cannot be"),
        ("group_names", "{", "'group_names' is no list"),
    ],
)
def test_damaged_counts(folder: Path, tmp_path: Path, name: str, value: object, words: str) -> None:
    path = tmp_path / "shard.h5"
    path.write_bytes(next(folder.glob("s*.h5")).read_bytes())
    with h5py.File(path, "r+") as file:
        if name in file:
            file[name][...] = value
        else:
            file.attrs.modify(name, np.bytes_(str(value)))
    with pytest.raises(DatasetError, match=words):
        shard = EchogramShard(path)
        shard.echogram(0, 0, counts=True)
