"""Chunks of HDF5 datasets, packed in threads: the library itself packs one after the other, under a lock.

What is written is what its filters would make: bytes are shuffled, deflated and followed by their checksum, in this
order, and any program that knows HDF5 reads them.

HDF5 File Format Specification 3.0, IV.A.2.l, filters 1 to 3; the checksum is Fletcher's, of 16-bit words, high byte
first.
"""

from __future__ import annotations

import itertools
import math
import struct
import zlib
from collections.abc import Iterable, Mapping
from functools import partial

import h5py
import numpy as np

from soundspaces_sim.core.numerics.kernel import at_once, kernel, over_rows

LEVEL = 4  # of deflate
FILTERS = {"shuffle": True, "compression": "gzip", "compression_opts": LEVEL, "fletcher32": True}
_CHUNKS = 64  # packed in one call


@kernel
def _checksums(first: int, last: int, data: np.ndarray, ends: np.ndarray, out: np.ndarray) -> None:
    """Fill `out` `first` to `last`: the checksum of `data` (bytes,) from `ends[k]` to `ends[k + 1]`."""
    for k in range(first, last):
        begin, end = ends[k], ends[k + 1]
        low, high = 0, 0
        for at in range(begin, end, 2):
            word = int(data[at]) << 8
            if at + 1 < end:
                word += data[at + 1]
            low += word
            low = (low & 0xFFFF) + (low >> 16)
            high += low
            high = (high & 0xFFFF) + (high >> 16)
        out[k] = high << 16 | low


def packed(values: np.ndarray) -> list[bytes]:
    """A chunk of each row of `values` (n, …), as the filters store it."""
    words = np.ascontiguousarray(values).reshape(len(values), -1).view(np.uint8)
    bytes_first = words.reshape(len(values), -1, values.dtype.itemsize).swapaxes(1, 2)
    deflated = [zlib.compress(row.tobytes(), LEVEL) for row in bytes_first]
    ends = np.cumsum([0, *map(len, deflated)])
    sums = np.empty(len(values), np.int64)
    _checksums(0, len(sums), np.frombuffer(b"".join(deflated), np.uint8), ends, sums)
    return [row + struct.pack("<I", of_row) for row, of_row in zip(deflated, sums.tolist(), strict=True)]


def put_whole(file: h5py.File, values: Mapping[str, np.ndarray]) -> None:
    """Datasets by name, of `values` that have entries, each of one chunk."""
    largest_first = sorted(values, key=lambda name: -values[name].nbytes)
    made = at_once(*(partial(packed, values[name][None]) for name in largest_first))
    chunk = dict(zip(largest_first, made, strict=True))
    for name, value in values.items():
        _put(file, name, value, value.shape, chunk[name])


def put_chunks(file: h5py.File, name: str, value: np.ndarray, axes: int) -> None:
    """A dataset of `value`, which has entries, with a chunk for each place on its first `axes`."""
    shape = value.shape[:axes]
    rows = value.reshape(math.prod(shape), *value.shape[axes:])
    chunks: list[list[bytes]] = [[] for _ in range(-(-len(rows) // _CHUNKS))]

    def call(first: int, last: int) -> None:
        chunks[first // _CHUNKS] = packed(rows[first:last])

    over_rows(call, len(rows), chunk=_CHUNKS)
    _put(file, name, value, (*[1] * axes, *value.shape[axes:]), (c for part in chunks for c in part))


def _put(
    file: h5py.File, name: str, value: np.ndarray, shape: tuple[int, ...], chunks: Iterable[bytes]
) -> None:
    """A dataset like `value`, in `chunks` of a `shape` that `packed` has made."""
    dataset = file.create_dataset(
        name, value.shape, value.dtype, chunks=shape, maxshape=value.shape, **FILTERS
    )
    places = itertools.product(*(range(0, n, c) for n, c in zip(value.shape, shape, strict=True)))
    for place, chunk in zip(places, chunks, strict=True):
        dataset.id.write_direct_chunk(place, chunk)
    # HDF5 lays out chunks when a dataset is closed. Left to Python, that is when its last reference goes, and a
    # profiler that looks at our frames (each of Dask's workers has one) can hold it longer: other bytes.
    dataset.id.close()
