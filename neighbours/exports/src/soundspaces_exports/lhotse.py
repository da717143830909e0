"""Export for Lhotse: `recordings.jsonl.gz` and `supervisions.jsonl.gz` of float32 WAV files.

`RecordingSet.from_file` and `SupervisionSet.from_file` read them; a recording is what `reverb_rir` takes. A
supervision holds the labels of its recording in `custom`. Nothing but this package is needed to write them. Paths
are relative to the manifests' folder, which can be moved: `RecordingSet.with_path_prefix(folder)` says where it is.
"""

from __future__ import annotations

import gzip
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from soundspaces_exports.samples import label_rows, labelled, sample_bytes, samples_of_pairs
from soundspaces_sim import RirDataset
from soundspaces_sim.parts import (
    WAV_HEADER as HEADER,
    ExportPlan,
    ExportProgress as Progress,
    check_headings,
    choose_pairs,
    make_folder,
    publish_file as publish,
    wav_bytes,
)

_MANIFEST_BYTES = 400  # of a sample, packed, about


def plan_lhotse(
    ds: RirDataset,
    out: str | Path,
    headings: tuple[float, ...] = (0.0,),
    ambisonics: bool = False,
    pairs: str | Path = "all",
) -> ExportPlan:
    """`out`/<scene>/audio/<scene>_<source>_<listener>_<heading>.wav of the chosen pairs (see `plan.choose_pairs`),
    and the manifests in `out`/<scene>. Paths in them are relative to that folder."""
    headings = check_headings(headings)
    samples = samples_of_pairs(choose_pairs(ds, pairs), headings, ambisonics)
    each = int(sample_bytes(ds, headings, ambisonics)) + HEADER + _MANIFEST_BYTES

    folder = Path(out).absolute() / ds.scene

    def write(progress: Progress) -> None:
        audio = make_folder(folder / "audio")
        recordings, supervisions = [], []
        for done, (sample, rir, labels) in enumerate(labelled(ds, samples, label_rows(ds))):
            key = sample.key(ds.scene)
            path = audio / f"{key}.wav"
            publish(path, wav_bytes(rir, ds.rate), durable=False)
            recordings.append(recording(key, f"audio/{path.name}", rir.shape, ds.rate))
            supervisions.append(supervision(key, rir.shape, ds.rate, labels))
            progress(done + 1, len(samples))
        publish(folder / "recordings.jsonl.gz", packed_lines(recordings), durable=False)
        publish(folder / "supervisions.jsonl.gz", packed_lines(supervisions), durable=False)

    return ExportPlan(Path(out), len(samples) + 2, len(samples) * each, write, [folder])


def recording(key: str, path: str, shape: Sequence[int], rate: int) -> dict[str, Any]:
    """Lhotse's record of an audio file with a response of `shape` (channels, samples); `path`: in the folder of the
    manifest, with slashes."""
    channels, samples = shape
    numbers = list(range(channels))
    return {
        "id": key,
        "sources": [{"type": "file", "channels": numbers, "source": path}],
        "sampling_rate": rate,
        "num_samples": samples,
        "duration": samples / rate,
        "channel_ids": numbers,
    }


def supervision(key: str, shape: Sequence[int], rate: int, labels: dict[str, Any]) -> dict[str, Any]:
    """Lhotse's record of the labels of a response of `shape` (channels, samples)."""
    return {
        "id": key,
        "recording_id": key,
        "start": 0.0,
        "duration": shape[1] / rate,
        "channel": list(range(shape[0])),
        "custom": labels,
    }


def packed_lines(rows: list[dict[str, Any]]) -> bytes:
    """JSON lines, packed; the same rows give the same bytes."""
    text = "".join(json.dumps(row, allow_nan=False) + "\n" for row in rows)
    return gzip.compress(text.encode(), mtime=0)
