"""Export for Hugging Face's `datasets`: Parquet files that `load_dataset(folder)` reads, without code of ours.

A row is a pair at a heading (or with `ambisonics` its ambisonic response) with the labels of the pair. Its column
`audio` is a float32 WAV file, which the schema declares as the feature `Audio`; `README.md` is the dataset card,
which says where the files are. Needs pyarrow (extra ``parquet``).
"""

from __future__ import annotations

import io
import json
from collections.abc import Mapping, Sequence
from importlib.util import find_spec
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
from soundspaces_sim import ConfigError, RirDataset
from soundspaces_sim.parts import (
    WAV_HEADER as HEADER,
    ExportPlan,
    ExportProgress as Progress,
    check_headings,
    choose_pairs,
    install_hint,
    make_folder,
    publish_file as publish,
    wav_bytes,
)

FILE_BYTES = 256e6  # of a Parquet file, about
_LABEL_BYTES = 512.0  # of a row, about
_TYPES = {bool: "bool", int: "int64", float: "float64", str: "string"}


def plan_huggingface(
    ds: RirDataset,
    out: str | Path,
    headings: tuple[float, ...] = (0.0,),
    ambisonics: bool = False,
    pairs: str | Path = "all",
) -> ExportPlan:
    """`out`/<scene>/data/train-<i>-of-<n>.parquet of the chosen pairs (see `plan.choose_pairs`) at `headings`, in
    random order drawn by the dataset's seed, and `out`/<scene>/README.md. Raises `ConfigError`."""
    if find_spec("pyarrow") is None:
        raise ConfigError(f"Parquet needs the pyarrow package: {install_hint('parquet')}")
    headings = check_headings(headings)
    samples = samples_of_pairs(choose_pairs(ds, pairs), headings, ambisonics)
    if not samples:
        raise ConfigError("huggingface: expected headings or ambisonics, got neither")
    each = sample_bytes(ds, headings, ambisonics) + HEADER + _LABEL_BYTES
    chosen = shuffled_files(ds, samples, max(int(FILE_BYTES / each), 1))
    files = len(chosen)

    folder = Path(out) / ds.scene

    def write(progress: Progress) -> None:
        data, table = make_folder(folder / "data"), label_rows(ds)
        for k, own in enumerate(chosen):
            publish(
                data / f"train-{k:05d}-of-{files:05d}.parquet",
                _parquet(ds, own, table),
                durable=False,
            )
            progress(k + 1, files + 1)
        publish(folder / "README.md", _card(ds).encode(), durable=False)
        progress(files + 1, files + 1)

    return ExportPlan(Path(out), files + 1, int(each * len(samples)) + 2**16, write, [folder])


def _parquet(ds: RirDataset, samples: Sequence[Sample], table: Mapping[tuple[int, int], Any]) -> bytes:
    """The file of some samples."""
    import pyarrow
    import pyarrow.parquet

    rows, kinds = [], _kinds(next(iter(table.values())).dtype)
    for sample, rir, labels in labelled(ds, samples, table):
        audio = {"bytes": wav_bytes(rir, ds.rate), "path": f"{sample.key(ds.scene)}.wav"}
        rows.append({"audio": audio, **{name: labels[name] for name in kinds}})
    audio_type = pyarrow.struct([("bytes", pyarrow.binary()), ("path", pyarrow.string())])
    fields = [("audio", audio_type), *((name, _arrow(kind)) for name, kind in kinds.items())]
    features: dict[str, Any] = {"audio": {"_type": "Audio"}}
    features |= {name: {"dtype": kind, "_type": "Value"} for name, kind in kinds.items()}
    described = {"huggingface": json.dumps({"info": {"features": features}})}
    content = pyarrow.Table.from_pylist(rows, pyarrow.schema(fields, described))
    out = io.BytesIO()
    pyarrow.parquet.write_table(content, out, compression="zstd", row_group_size=100)
    return out.getvalue()


def _arrow(kind: str) -> Any:
    import pyarrow

    return pyarrow.bool_() if kind == "bool" else pyarrow.type_for_alias(kind)


def _kinds(of: np.dtype) -> dict[str, str]:
    """The type of each label's column, by its name."""
    found = {name: _TYPES[type(np.zeros(1, of[name]).item())] for name in of.names or ()}
    return found | {
        "scene": "string",
        "rate": "int64",
        "heading_deg": "float64",
        "azimuth_deg": "float64",
        "elevation_deg": "float64",
    }


def _card(ds: RirDataset) -> str:
    """The dataset card: YAML that names the files, then what they are."""
    config = ds.manifest.config.dataset
    licence = f"license_name: {json.dumps(config.licence)}\nlicense: other\n" if config.licence else ""
    return f"""---
configs:
- config_name: default
  data_files:
  - split: train
    path: data/train-*.parquet
{licence}tags:
- audio
- room-impulse-response
---
# Room impulse responses of {ds.scene}

Simulated with soundspaces_sim {ds.manifest.code_version}. `audio`: float32 WAV, {ds.rate} Hz; two channels are
the left and the right ear of a head that faces `heading_deg` (degrees, counter-clockwise from +x); nine are
ambisonics (ACN, SN3D, world axes), and `heading_deg` is empty. Direct sound is sqrt(1 / (4 pi)) / r.
`azimuth_deg` and `elevation_deg`: where the source is from the listener, positive to the left and up. An empty
label could not be measured.

{config.citation}
"""
