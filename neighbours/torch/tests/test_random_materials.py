"""Random furniture: the distribution of draws, their limits, and the reader for PyTorch that draws them."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from soundspaces_pictures.report import write_report
from soundspaces_torch.random_materials import RandomMaterials, draw_furnished

import soundspaces_sim as ss
from soundspaces_sim.core.config import DatasetConfig
from soundspaces_sim.core.errors import ConfigError, DatasetError, MaterialError
from soundspaces_sim.echogram.material_spread import reproducibility, variety
from soundspaces_sim.echogram.measures import room_measures
from soundspaces_sim.echogram.reflection_counts import MaterialGroups
from soundspaces_sim.echogram.refurnish import MOST_DB, closure_error_db
from tests.command_line import run_command
from tests.marks import ci_slow
from tests.rooms import box, plain

POINTS = [[1.0, 1.2, 1.1], [3.9, 1.1, 1.6], [3.2, 3.1, 0.9]]
BANDS = (125.0, 500.0, 2000.0)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    names = ("carpet", "gypsum-board", "acoustic-tile")
    absorption = np.repeat(np.array([[0.2], [0.08], [0.5]]), 2, axis=1)
    none = np.zeros((3, 2))
    materials = ss.MaterialTable(names, np.array([250.0, 2000.0]), absorption, none + 0.6, none)
    room = box((5.0, 4.0, 3.0), materials, [1, 1, 1, 1, 0, 2])
    job = ss.JobConfig(
        simulation=plain(walks=64, duration=0.3, materials=True),
        dataset=DatasetConfig(rate=8000, headings=(0.0, 90.0)),
    )
    return ss.build_dataset(room, tmp_path_factory.mktemp("m"), job, points=np.array(POINTS)).folder


@pytest.fixture
def ds(folder: Path) -> Iterator[ss.RirDataset]:
    with ss.open_dataset(folder) as found:
        yield found


def test_draws_have_the_spreads_of_the_tables() -> None:
    """ln(a / (1 - a)), a = α / (1 - τ), of 4,000 draws: the simulated one in the mean, the variances of kind and
    laboratories in sum, that of the kind between bands; z below 4.5 for all 12 moments."""
    absorption, transmission = np.array([[0.3, 0.4], [0.05, 0.1]]), np.array([[0.2, 0.0], [0.0, 0.1]])
    groups = MaterialGroups(
        ("carpet", "glass"), np.array([0.5, 0.5]), absorption, transmission, -absorption
    )
    rng, count = np.random.default_rng(0), 4000
    drawn = np.array([RandomMaterials().draw(groups, BANDS, rng) for _ in range(count)])
    assert (drawn > 0.0).all() and (drawn < 1.0 - transmission).all()
    share = drawn / (1.0 - transmission)
    logit = np.log(share / (1.0 - share))
    a = absorption / (1.0 - transmission)
    kind = variety(groups.names)[:, None] ** 2
    own = (reproducibility(absorption, BANDS) / (1.0 - transmission) / (a * (1.0 - a))) ** 2
    variance = kind + own
    z = (logit.mean(axis=0) - np.log(a / (1.0 - a))) / np.sqrt(variance / count)
    assert np.abs(z).max() < 4.5
    found = logit.var(axis=0, ddof=1)
    assert np.abs((found / variance - 1.0) / np.sqrt(2.0 / (count - 1))).max() < 4.5
    for m in range(2):
        between = np.cov(logit[:, m].T)[0, 1]
        error = np.sqrt((variance[m].prod() + kind[m, 0] ** 2) / count)
        assert abs(between - kind[m, 0]) < 4.5 * error


def test_some_materials_or_none() -> None:
    absorption = np.array([[0.0, 1.0], [0.05, 0.1]])
    groups = MaterialGroups(
        ("carpet", "glass"), np.full(2, 0.5), absorption, np.zeros((2, 2)), -absorption
    )
    rng = np.random.default_rng(0)
    np.testing.assert_array_equal(RandomMaterials(0.0).draw(groups, BANDS, rng), absorption)
    one = RandomMaterials(names=["glass"]).draw(groups, BANDS, rng)
    np.testing.assert_array_equal(one[0], absorption[0])
    assert (one[1] != absorption[1]).all()
    ends = RandomMaterials().draw(groups, BANDS, rng)
    assert np.isfinite(ends).all() and (ends >= 0.0).all() and (ends < 1.0).all()
    with pytest.raises(MaterialError, match="'marble' were not counted, only those by carpet, glass"):
        RandomMaterials(names=["marble"]).check(groups)
    for bad in (-1.0, float("nan"), float("inf")):
        with pytest.raises(ConfigError, match="scale must be a finite number"):
            RandomMaterials(bad)
    with pytest.raises(ConfigError, match="names must be a list"):
        RandomMaterials(names="glass")


def test_draws_stay_where_counts_reach(ds: ss.RirDataset, dataset_folder: Path) -> None:
    """A draw of thrice the spread is moved back; the echogram is that of the absorption that is told."""
    rng, moved = np.random.default_rng(1), 0
    plainly = ds._stored.counted(0, 1)
    for _ in range(20):
        state = rng.bit_generator.state
        echogram, absorption = draw_furnished(ds.counted(0, 1), RandomMaterials(3.0), rng)
        assert closure_error_db(plainly, absorption) <= MOST_DB * (1.0 + 1e-9)
        again = np.random.default_rng()
        again.bit_generator.state = state
        assert plainly.counts is not None
        wanted = RandomMaterials(3.0).draw(plainly.counts.groups, plainly.bands, again)
        moved += not np.allclose(absorption, wanted, rtol=1e-12)
        names = [m.name for m in ds.materials]
        asked = ds.echogram(
            0, 1, materials=dict(zip(names, absorption.tolist(), strict=True)), force=True
        )
        np.testing.assert_array_equal(asked.energy, echogram.energy)
    assert 0 < moved < 20
    with ss.open_dataset(dataset_folder) as old, pytest.raises(DatasetError, match="holds no counts"):
        draw_furnished(old.counted(0, 1), RandomMaterials(), rng)


def test_spreads_of_measures(ds: ss.RirDataset) -> None:
    found = ds.material_spread(0, 1)
    assert set(found) >= {"t30", "edt", "c80", "d50"} and found["c80"].shape == (4,)
    assert (found["c80"] > 0.0).all() and (found["c80"] < 3.0).all()
    rows = ds.with_spreads(ds.table())
    k = int(np.flatnonzero((rows["source"] == 0) & (rows["listener"] == 1))[0])
    np.testing.assert_array_equal(
        [rows[f"c80_spread_{b}"][k] for b in range(4)], found["c80"].astype("f4")
    )
    assert ds.columns(spreads=True)["c80_spread_2"]["unit"] == "dB"
    assert set(ds.columns(spreads=True)) == set(rows.dtype.names or ())


@ci_slow
def test_spreads_in_the_table_and_the_report(folder: Path, tmp_path: Path) -> None:
    result = run_command("table", str(folder), "--spreads", "--out", "t.csv", cwd=tmp_path)
    assert result.returncode == 0
    assert "t30_spread_0" in (tmp_path / "t.csv").read_text().splitlines()[0]
    write_report(folder, tmp_path / "r.html")
    assert "by how well absorption is known" in (tmp_path / "r.html").read_text()


def _read(data: Any, **how: Any) -> list[np.ndarray]:
    torch = pytest.importorskip("torch", reason="the extra 'torch' is not installed")
    batches = list(torch.utils.data.DataLoader(data, batch_size=4, **how))
    return [np.concatenate([b[name].numpy() for b in batches]) for name in ("absorption", "rir", "c50")]


def test_the_reader_for_pytorch(ds: ss.RirDataset, dataset_folder: Path) -> None:
    """By seed, epoch and item alone, whatever the workers; labels and responses are those of the draw."""
    pytest.importorskip("torch", reason="the extra 'torch' is not installed")
    from soundspaces_torch.dataset import TorchRirDataset

    data = TorchRirDataset(ds, samples=400, seed=5, materials=RandomMaterials(), collocated=True)
    epochs = []
    for epoch in range(2):
        data.set_epoch(epoch)
        epochs.append(_read(data))
        for one, other in zip(_read(data, num_workers=2), epochs[-1], strict=True):
            np.testing.assert_array_equal(one, other)
    assert epochs[0][0].shape == (9, 3, 4) and np.isfinite(epochs[0][0]).all()
    assert not np.array_equal(epochs[0][0], epochs[1][0])
    item = data[1]
    names = [m.name for m in ds.materials]
    asked = dict(zip(names, item["absorption"].double().tolist(), strict=True))
    echogram = ds.echogram(0, 1, materials=asked, force=True)
    np.testing.assert_allclose(item["c50"], room_measures(echogram).c50, atol=1e-4)
    np.testing.assert_allclose(item["late_error"], echogram.relative_error[1], rtol=1e-4)
    assert "c50_error" not in item and item["distance"] == np.float32(
        ds.table(collocated=True)[1]["distance"]
    )
    with ss.open_dataset(dataset_folder) as old, pytest.raises(DatasetError, match="holds no counts"):
        TorchRirDataset(old, materials=RandomMaterials())
    plainly = TorchRirDataset(ds, samples=400, seed=5)
    assert plainly[1]["heading_deg"] == data[1]["heading_deg"] and "absorption" not in plainly[1]
