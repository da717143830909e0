"""Tar files for training that streams: read back as clients of the format do."""

from __future__ import annotations

import io
import json
import tarfile
from pathlib import Path

import numpy as np
import pytest
from soundspaces_exports import webdataset

import soundspaces_sim as ss
from soundspaces_sim.dataset.exporters.plan import carry_out
from soundspaces_sim.dataset.labels import source_direction


def _samples(folder: Path) -> dict[str, dict[str, bytes]]:
    """Files of all tars, grouped by key in the order in which they lie: neighbours belong together."""
    found: dict[str, dict[str, bytes]] = {}
    last = None
    for path in sorted(folder.glob("*.tar")):
        with tarfile.open(path) as tar:
            for member in tar:
                key, _, kind = member.name.partition(".")
                assert key == last or key not in found, "a sample's files are neighbours"
                last = key
                content = tar.extractfile(member)
                assert content is not None
                found.setdefault(key, {})[kind] = content.read()
    return found


def test_samples_are_the_readers(
    dataset_folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(webdataset, "SHARD_BYTES", 3e5)  # several files
    with ss.open_dataset(dataset_folder, 16000) as ds:
        plan = webdataset.plan_webdataset(ds, tmp_path, (0.0, 22.5), ambisonics=True)
        assert carry_out(plan) == plan.files == len(list(tmp_path.glob("*.tar"))) > 1
        written = sum(p.stat().st_size for p in tmp_path.iterdir())
        assert 0.7 * plan.bytes < written < 1.3 * plan.bytes
        samples = _samples(tmp_path)
        n = len(ds.points)
        assert len(samples) == 3 * n * n
        keys = list(samples)
        assert keys != sorted(keys)  # shuffled
        table = ds.table()
        row = table[(table["source"] == 1) & (table["listener"] == 2)][0]
        for key, wanted in (
            ("two_rooms_1_2_0", ds.binaural(1, 2, 0.0)), ("two_rooms_1_2_22p5", ds.binaural(1, 2, 22.5)),
            ("two_rooms_1_2_sn3d", ds.ambisonic(1, 2)),
        ):  # fmt: skip
            np.testing.assert_array_equal(np.load(io.BytesIO(samples[key]["npy"])), wanted)
            labels = json.loads(samples[key]["json"])
            assert labels["rate"] == 16000 and labels["distance"] == pytest.approx(row["distance"])
            azimuth, elevation = source_direction(ds, 1, 2, labels["heading_deg"] or 0.0)
            assert labels["azimuth_deg"] == pytest.approx(azimuth)
            assert labels["elevation_deg"] == pytest.approx(elevation)
        again = tmp_path / "again"
        carry_out(webdataset.plan_webdataset(ds, again, (0.0, 22.5), ambisonics=True))
        for path in tmp_path.glob("*.tar"):
            assert (again / path.name).read_bytes() == path.read_bytes()


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")  # it leaves files open
def test_the_library_reads_them(dataset_folder: Path, tmp_path: Path) -> None:
    """`webdataset` itself, as a training loop calls it."""
    wds = pytest.importorskip("webdataset", reason="webdataset is not installed")
    with ss.open_dataset(dataset_folder, 16000) as ds:
        carry_out(webdataset.plan_webdataset(ds, tmp_path, (0.0,)))
        paths = [str(p) for p in sorted(tmp_path.glob("*.tar"))]
        found = list(wds.WebDataset(paths, shardshuffle=False).decode().to_tuple("npy", "json"))
        assert len(found) == len(ds)
        for rir, labels in found[:5]:
            assert labels["rate"] == 16000 and labels["heading_deg"] == 0.0
            np.testing.assert_array_equal(rir, ds.binaural(labels["source"], labels["listener"], 0.0))
