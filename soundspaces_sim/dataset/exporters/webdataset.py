"""Export as WebDataset: tar files of samples in random order, for training that streams.

A sample is a pair at a heading: `<scene>_<source>_<listener>_<heading>.npy`, float32 (2, n), or with `ambisonics`
`<scene>_<source>_<listener>_sn3d.npy`, (9, n), and a `.json` beside it with the labels of the pair. Readers of the
format shuffle within a buffer only, so the order is drawn here, by the dataset's seed. The same dataset gives the
same bytes.
"""

from __future__ import annotations

import io
import json
import math
import tarfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from soundspaces_sim.core.io.files import make_folder, publish
from soundspaces_sim.core.numerics.axes import CHANNELS
from soundspaces_sim.dataset.exporters.plan import (
    ExportPlan,
    Progress,
    check_headings,
    choose_pairs,
    samples_of,
)
from soundspaces_sim.dataset.labels import source_direction
from soundspaces_sim.dataset.reader import RirDataset

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
    rows = choose_pairs(ds, pairs)
    forms: list[float | None] = [*headings, *([None] if ambisonics else [])]
    each = (
        4.0 * samples_of(ds) * (2 * len(headings) + CHANNELS * ambisonics) / max(len(forms), 1)
        + _HEAD_BYTES
    )
    samples = [(int(s), int(l), form) for s, l in rows for form in forms]
    order = np.random.default_rng(ds.manifest.config.dataset.seed).permutation(len(samples))
    per_file = max(int(SHARD_BYTES / each), 1)
    files = math.ceil(len(samples) / per_file)

    def write(progress: Progress) -> None:
        folder = make_folder(Path(out))
        labels = {(int(r["source"]), int(r["listener"])): r for r in ds.table(collocated=True)}
        for k in range(files):
            chosen = [samples[i] for i in order[k * per_file : (k + 1) * per_file]]
            data = io.BytesIO()
            with tarfile.open(fileobj=data, mode="w", format=tarfile.USTAR_FORMAT) as tar:
                for name, content in _members(ds, chosen, labels):
                    info = tarfile.TarInfo(name)
                    info.size, info.mode = len(content), 0o644
                    tar.addfile(info, io.BytesIO(content))
            publish(folder / f"{ds.scene}-{k:06d}.tar", data.getvalue(), durable=False)
            progress(k + 1, files)

    return ExportPlan(Path(out), files, int(each * len(samples)) + 10240 * files, write)


def _members(
    ds: RirDataset, samples: list[tuple[int, int, float | None]], labels: dict[tuple[int, int], Any]
) -> Iterator[tuple[str, bytes]]:
    """Names and contents of the files of samples."""
    for s, l, heading in samples:
        rir = ds.ambisonic(s, l) if heading is None else ds.binaural(s, l, heading)
        data = io.BytesIO()
        np.save(data, rir)
        key = f"{ds.scene}_{s}_{l}_{'sn3d' if heading is None else f'{heading:g}'}".replace(".", "p")
        yield f"{key}.npy", data.getvalue()
        row = labels[s, l]
        content = {name: _plain(row[name]) for name in row.dtype.names}
        azimuth, elevation = source_direction(ds, s, l, heading or 0.0)
        content |= {"scene": ds.scene, "rate": ds.rate, "heading_deg": heading}
        content |= {"azimuth_deg": _plain(azimuth), "elevation_deg": _plain(elevation)}
        yield f"{key}.json", json.dumps(content, allow_nan=False).encode()


def _plain(value: Any) -> Any:
    """A number or truth value that JSON has; None for NaN and infinity."""
    plain = value.item() if isinstance(value, np.generic) else value
    return None if isinstance(plain, float) and not math.isfinite(plain) else plain
