"""The reader for PyTorch: one dataset or several, headings from epoch to epoch, labels."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import soundspaces_sim as ss
from soundspaces_sim.dataset.labels import source_direction

torch = pytest.importorskip("torch", reason="the extra 'torch' is not installed")

from soundspaces_sim.torch import TorchRirDataset  # noqa: E402


@pytest.fixture(scope="module")
def several(dataset_folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two folders with the same dataset: scenes a and b."""
    root = tmp_path_factory.mktemp("several")
    for name in ("a", "b"):
        shutil.copytree(dataset_folder, root / name)
    return root


def _headings(data: Any, **how: Any) -> list[float]:
    """Of every item, in order, as a loader gives them."""
    loader = torch.utils.data.DataLoader(data, batch_size=8, **how)
    return [float(h) for batch in loader for h in batch["heading_deg"]]


def test_items_are_the_readers(dataset_folder: Path) -> None:
    with ss.open_dataset(dataset_folder) as ds:
        data = TorchRirDataset(ds, samples=2000, seed=0)
        loader = torch.utils.data.DataLoader(data, batch_size=8, num_workers=2)
        batch = next(iter(loader))
        assert batch["rir"].shape == (8, 2, 2000) and batch["rir"].dtype == torch.float32
        torch.testing.assert_close(batch["rir"][3], data[3]["rir"])
        assert len(data) == len(ds.table()) == 56 and batch["scene"] == ["two_rooms"] * 8
        item = data[11]
        s, l = item["pair"].tolist()
        want = ds.binaural(s, l, item["heading_deg"])[:, :2000]
        np.testing.assert_array_equal(item["rir"][:, : want.shape[1]], want)


def test_labels_are_those_of_the_table(dataset_folder: Path) -> None:
    with ss.open_dataset(dataset_folder) as ds:
        table = ds.table(collocated=True)
        n = len(ds.points)
        data = TorchRirDataset(ds, [(1, 3), (4, 0), (2, 2)], samples=100, seed=0)
        for item in (data[k] for k in range(3)):
            s, l = item["pair"].tolist()
            row = table[s * n + l]
            assert (row["source"], row["listener"]) == (s, l)
            for name in ("t30", "drr", "c80", "late_error"):
                np.testing.assert_array_equal(item[name].numpy(), [row[f"{name}_{b}"] for b in range(4)])
            assert item["distance"] == row["distance"] and bool(item["visible"]) == row["visible"]
            assert bool(item["collocated"]) == (s == l)
        few = TorchRirDataset(ds, [(1, 3)], samples=100, labels=("t30",))[0]
        assert "t30" in few and "drr" not in few
        with pytest.raises(ss.ConfigError, match=r"labels: no 'rt60' in the table; there are .*t30"):
            TorchRirDataset(ds, labels=("rt60",))
        with pytest.raises(ss.PairIndexError, match=r"pair \[1, 99\] is out of range"):
            TorchRirDataset(ds, [(1, 99)])


def test_directions_of_sources(dataset_folder: Path) -> None:
    """Left of a head that faces +X is +Y: azimuth 90; turned to +Y it is ahead; behind is 180, not -180."""
    with ss.open_dataset(dataset_folder) as ds:
        ds.points = np.array([[1.0, 1.0, 1.0], [1.0, 3.0, 1.0], [3.0, 1.0, 3.0]])
        assert source_direction(ds, 1, 0) == pytest.approx((90.0, 0.0))
        assert source_direction(ds, 1, 0, 90.0) == pytest.approx((0.0, 0.0))
        assert source_direction(ds, 1, 0, 270.0) == pytest.approx((180.0, 0.0))
        assert source_direction(ds, 2, 0, 45.0) == pytest.approx((-45.0, 45.0))  # 2 m ahead, 2 m up
        assert np.isnan(source_direction(ds, 0, 0)).all()


def test_a_collection_is_one_dataset(several: Path) -> None:
    with ss.open_datasets(several) as scenes:
        data = TorchRirDataset(scenes, samples=500, seed=1)
        n = len(scenes["a"].points)
        assert len(data) == scenes.pairs - 2 * n
        first, last = data[3], data[n * n - n + 5]
        assert (first["scene"], last["scene"]) == ("a", "b")
        assert first["pair"].tolist() == [0, 4] and last["pair"].tolist() == [0, 6]
        drawn = scenes.sample(6, seed=2)
        some = TorchRirDataset(scenes, drawn, samples=500, kind="ambisonic")
        assert [(i["scene"], *i["pair"].tolist()) for i in (some[k] for k in range(6))] == drawn
        name, s, l = drawn[4]
        want = scenes[name].ambisonic(s, l)[:, :500]
        np.testing.assert_array_equal(some[4]["rir"], want)
        assert some[4]["heading_deg"] == 0.0  # world axes
        loader = torch.utils.data.DataLoader(some, batch_size=6, num_workers=1)
        assert next(iter(loader))["t30"].shape == (6, 4)
        with pytest.raises(ss.ConfigError, match=r"with a scene of a, b, got \('c', 0, 1\)"):
            TorchRirDataset(scenes, [("c", 0, 1)])


def test_scenes_that_differ_are_named(several: Path) -> None:
    with ss.open_datasets(several) as scenes:
        scenes["b"].rate = 8000
        with pytest.raises(
            ss.ConfigError,
            match=r"rate, Hz: expected the same for all scenes, got 16000 for a and 8000 for b",
        ):
            TorchRirDataset(scenes)


@pytest.mark.parametrize("workers", [{"num_workers": 0}, {"num_workers": 2}])
def test_headings_change_from_epoch_to_epoch(dataset_folder: Path, workers: dict[str, int]) -> None:
    """By default PyTorch's generator draws them, and its seed repeats a run."""
    data = TorchRirDataset(ss.open_dataset(dataset_folder), samples=10, labels=())
    torch.manual_seed(7)
    first, second = _headings(data, **workers), _headings(data, **workers)
    assert first != second and set(first) == set(second) == {0.0, 90.0, 180.0, 270.0}
    torch.manual_seed(7)
    assert _headings(data, **workers) == first


def test_headings_of_a_seed_and_an_epoch(dataset_folder: Path) -> None:
    """The same whatever the workers, those that stay from one epoch to the next included."""
    data = TorchRirDataset(ss.open_dataset(dataset_folder), samples=10, labels=(), seed=3)
    wanted = []
    for epoch in range(2):
        data.set_epoch(epoch)
        wanted.append(_headings(data))
    assert wanted[0] != wanted[1]
    loader = torch.utils.data.DataLoader(data, batch_size=8, num_workers=2, persistent_workers=True)
    for epoch in (0, 1, 0):
        data.set_epoch(epoch)
        assert [float(h) for batch in loader for h in batch["heading_deg"]] == wanted[epoch]


def test_pairs_are_those_of_the_table(dataset_folder: Path) -> None:
    with ss.open_dataset(dataset_folder) as ds:
        for collocated in (False, True):
            data = TorchRirDataset(ds, labels=(), collocated=collocated)
            table = ds.table(collocated=collocated)
            rows = np.stack([table["source"], table["listener"]], axis=1)
            np.testing.assert_array_equal(data.pairs, rows)


def test_workers_cannot_use_another_device() -> None:
    from soundspaces_torch import dataset as torch_dataset

    torch_dataset._check_worker(torch.device("cuda"))  # no worker here
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(torch.utils.data, "get_worker_info", lambda: object())
        torch_dataset._check_worker(torch.device("cpu"))
        with pytest.raises(
            ss.ConfigError, match="workers cannot render on cuda; give the loader num_workers=0"
        ):
            torch_dataset._check_worker(torch.device("cuda"))
