"""Exports for Hugging Face's datasets and for Lhotse, read as those read them."""

import gzip
import io
import json
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet
import pytest
import soundfile
from soundspaces_exports.huggingface import plan_huggingface
from soundspaces_exports.lhotse import plan_lhotse

import soundspaces_sim as ss
from soundspaces_sim.core.errors import ConfigError
from soundspaces_sim.dataset.exporters.plan import carry_out


def test_parquet_has_waveforms_labels_and_the_features_that_datasets_reads(
    dataset_folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """`datasets` takes features from the key "huggingface" of the schema; a file for a few rows each; every sample
    once."""
    ds = ss.open_dataset(dataset_folder)
    pairs = tmp_path / "pairs.txt"
    pairs.write_text("0 1\n1 2\n2 2\n")
    monkeypatch.setattr("soundspaces_exports.huggingface.FILE_BYTES", 2e5)
    plan = plan_huggingface(ds, tmp_path / "out", (0.0, 90.0), True, pairs)
    assert carry_out(plan) == plan.files > 2
    folder = tmp_path / "out" / ds.scene
    card = (folder / "README.md").read_text(encoding="utf-8")
    assert card.startswith("---\n") and "path: data/train-*.parquet" in card
    files = sorted((folder / "data").iterdir())
    assert len(files) == plan.files - 1
    seen = {}
    for path in files:
        table = pyarrow.parquet.read_table(path)
        features = json.loads(table.schema.metadata[b"huggingface"])["info"]["features"]
        assert list(features) == table.column_names and features["audio"] == {"_type": "Audio"}
        assert features["t60"]["dtype"] == "float64" if "t60" in features else True
        for row in table.to_pylist():
            sound, rate = soundfile.read(io.BytesIO(row["audio"]["bytes"]), dtype="float32")
            assert rate == row["rate"] == ds.rate
            seen[row["source"], row["listener"], row["heading_deg"]] = sound.T, row
    assert set(seen) == {(s, l, h) for s, l in ((0, 1), (1, 2), (2, 2)) for h in (0.0, 90.0, None)}
    for (s, l, heading), (sound, row) in seen.items():
        expected = ds.ambisonic(s, l) if heading is None else ds.binaural(s, l, heading)
        np.testing.assert_array_equal(sound, expected)
        np.testing.assert_allclose(
            row["distance"], np.linalg.norm(ds.points[s] - ds.points[l]), atol=1e-5
        )
        assert (row["azimuth_deg"] is None) == (s == l)
    with pytest.raises(ConfigError, match="neither"):
        plan_huggingface(ds, tmp_path, (), False)


def test_lhotse_manifests_name_files_that_have_what_they_say(
    dataset_folder: Path, tmp_path: Path
) -> None:
    ds = ss.open_dataset(dataset_folder)
    pairs = tmp_path / "pairs.txt"
    pairs.write_text("0 1\n1 2\n")
    assert carry_out(plan_lhotse(ds, tmp_path / "out", (180.0,), True, pairs)) == 4 + 2
    folder = tmp_path / "out" / ds.scene

    def rows(name: str) -> list[dict[str, Any]]:
        return [json.loads(line) for line in gzip.decompress((folder / name).read_bytes()).splitlines()]

    recordings, supervisions = rows("recordings.jsonl.gz"), rows("supervisions.jsonl.gz")
    assert [r["id"] for r in recordings] == [s["recording_id"] for s in supervisions]
    for recording, supervision in zip(recordings, supervisions, strict=True):
        (source,) = recording["sources"]
        assert source["source"].startswith("audio/")  # `with_path_prefix` says where the folder is
        sound, rate = soundfile.read(folder / source["source"], dtype="float32")
        assert source["channels"] == recording["channel_ids"] == list(range(sound.shape[1]))
        assert (rate, len(sound)) == (recording["sampling_rate"], recording["num_samples"])
        assert recording["duration"] == supervision["duration"] == len(sound) / rate
        labels = supervision["custom"]
        heading = labels["heading_deg"]
        s, l = labels["source"], labels["listener"]
        expected = ds.ambisonic(s, l) if heading is None else ds.binaural(s, l, 180.0)
        np.testing.assert_array_equal(sound.T, expected)
