"""Shards in HDF5's oldest layout, as a stranger may write them: trees of chunks and heaps of texts without checksums."""

from __future__ import annotations

import shutil
from pathlib import Path

import h5py

GOLDEN = Path(__file__).resolve().parents[1] / "golden" / "echogram-8"


def old_layout(folder: Path) -> Path:
    """A copy of a golden dataset in `folder`, its shards in that layout; sizes and digests are those of the original."""
    shutil.copytree(GOLDEN, folder)
    for path in folder.glob("*.h5"):
        with h5py.File(GOLDEN / path.name) as source, h5py.File(path, "w", libver="earliest") as target:
            for name, value in source.attrs.items():
                target.attrs[name] = value.decode() if isinstance(value, bytes) else value
            for name, item in source.items():
                whole = item.chunks is None or any(
                    c > n for c, n in zip(item.chunks, item.shape, strict=True)
                )
                how = {} if whole else {"chunks": item.chunks, "compression": item.compression}
                target.create_dataset(name, data=item[...], **how)
    return folder
