"""Export as WebDataset: tar files of samples in random order, for training that streams.

A sample is a pair at a heading: `<scene>_<source>_<listener>_<heading>.npy`, float32 (2, n), or with `ambisonics`
`<scene>_<source>_<listener>_sn3d.npy`, (9, n), and a `.json` beside it with the labels of the pair. Readers of the
format shuffle within a buffer only, so the order is drawn here, by the dataset's seed. The same dataset gives the
same bytes.
"""

from __future__ import annotations

import io
import json
import tarfile
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from soundspaces_exports.samples import (
    Sample,
    label_rows,
    labelled,
    sample_bytes,
    samples_of_pairs,
    shuffled_files,
)
from soundspaces_sim import RirDataset
from soundspaces_sim.parts import (
    ExportPlan,
    ExportProgress as Progress,
    check_headings,
    choose_pairs,
    make_folder,
    publish_file as publish,
)

SHARD_BYTES = 64e6  # of a tar file, about
_HEAD_BYTES = 3 * 512 + 1024  # of a sample: tar headers, padding, labels


def plan_webdataset(
    ds: RirDataset,
    out: str | Path,
    headings: tuple[float, ...] = (0.0,),
    ambisonics: bool = False,
    pairs: str | Path = "all",
) -> ExportPlan:
    """`out`/<scene>-<number>.tar of the chosen pairs (see `plan.choose_pairs`) at `headings`."""
    headings = check_headings(headings)
    samples = samples_of_pairs(choose_pairs(ds, pairs), headings, ambisonics)
    each = sample_bytes(ds, headings, ambisonics) + _HEAD_BYTES
    chosen = shuffled_files(ds, samples, max(int(SHARD_BYTES / each), 1))
    files = len(chosen)
    places = [Path(out) / f"{ds.scene}-{k:06d}.tar" for k in range(files)]

    def write(progress: Progress) -> None:
        make_folder(Path(out))
        rows = label_rows(ds)
        for k, (path, own) in enumerate(zip(places, chosen, strict=True)):
            data = io.BytesIO()
            with tarfile.open(fileobj=data, mode="w", format=tarfile.USTAR_FORMAT) as tar:
                for name, content in _members(ds, own, rows):
                    info = tarfile.TarInfo(name)
                    info.size, info.mode = len(content), 0o644
                    tar.addfile(info, io.BytesIO(content))
            publish(path, data.getvalue(), durable=False)
            progress(k + 1, files)

    return ExportPlan(Path(out), files, int(each * len(samples)) + 10240 * files, write, places)


def _members(
    ds: RirDataset, samples: Sequence[Sample], rows: Mapping[tuple[int, int], Any]
) -> Iterator[tuple[str, bytes]]:
    """Names and contents of the files of samples."""
    for sample, rir, labels in labelled(ds, samples, rows):
        data = io.BytesIO()
        np.save(data, rir)
        key = sample.key(ds.scene)
        yield f"{key}.npy", data.getvalue()
        yield f"{key}.json", json.dumps(labels, allow_nan=False).encode()
