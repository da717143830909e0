"""Chunks that are packed in threads: what HDF5 itself reads and would have written."""

import io
from concurrent.futures import ThreadPoolExecutor

import h5py
import numpy as np
import pytest

from soundspaces_sim.core.io.chunks import FILTERS, put_chunks, put_whole
from soundspaces_sim.core.io.hdf5 import create_hdf5
from soundspaces_sim.core.numerics.kernel import set_thread_count, thread_count

SHAPES = [
    ((3, 5, 17), np.uint8),
    ((9, 8, 40, 2), np.int8),
    ((2, 3, 11), np.float32),
    ((1, 1, 1), np.int16),
]


def _written(value: np.ndarray, threads: int, whole: bool = False) -> bytes:
    before = thread_count()
    set_thread_count(threads)
    try:
        return _content(value, whole)
    finally:
        set_thread_count(before)


def _content(value: np.ndarray, whole: bool = False) -> bytes:
    content = io.BytesIO()
    with create_hdf5(content) as file:
        if whole:
            put_whole(file, {"values": value, "others": value[0]})
        else:
            put_chunks(file, "values", value, 2)
    return content.getvalue()


@pytest.mark.parametrize(("shape", "kind"), SHAPES)
@pytest.mark.parametrize("steps", [1, 3, 300])
@pytest.mark.parametrize("whole", [False, True])
def test_hdf5_reads_them_and_would_write_the_same(
    shape: tuple[int, ...], kind: type, steps: int, whole: bool
) -> None:
    """The library checks each chunk's checksum when it reads; its own chunks have the same bytes where its deflate
    is that of Python, and unpack to the same where it is not."""
    random = np.random.default_rng(steps)
    value: np.ndarray = random.integers(0, steps, shape).astype(kind)
    with h5py.File(io.BytesIO(_written(value, 1, whole))) as file:
        found = file["values"]
        np.testing.assert_array_equal(found[:], value)
        assert found.dtype == value.dtype and found.chunks == (shape if whole else (1, 1, *shape[2:]))
        assert (found.compression, found.compression_opts, found.shuffle, found.fletcher32) == (
            "gzip", 4, True, True,
        )  # fmt: skip
        own = io.BytesIO()
        with h5py.File(own, "w") as other:
            other.create_dataset("values", data=value, chunks=found.chunks, **FILTERS)
            for place in np.ndindex((1, 1) if whole else shape[:2]):
                at = (*place, *[0] * (len(shape) - 2))
                mask, ours = found.id.read_direct_chunk(at)
                theirs_mask, theirs = other["values"].id.read_direct_chunk(at)
                assert mask == theirs_mask == 0
                assert len(ours) - len(theirs) <= 16
                if ours[:-4] == theirs[:-4]:
                    assert ours == theirs  # the checksum of the same bytes


def test_a_damaged_chunk_is_told() -> None:
    value = np.random.default_rng(0).integers(0, 9, (2, 2, 90)).astype(np.int8)
    content = bytearray(_written(value, 1))
    with h5py.File(io.BytesIO(bytes(content))) as file:
        at = file["values"].id.get_chunk_info(1).byte_offset
    content[at + 10] ^= 4
    with h5py.File(io.BytesIO(bytes(content))) as file, pytest.raises(OSError, match="read"):
        file["values"][:]


def test_threads_change_no_byte() -> None:
    value = np.random.default_rng(1).integers(0, 9, (12, 17, 50, 3)).astype(np.int8)
    assert _written(value, 1) == _written(value, 3)


def test_files_are_written_in_threads_side_by_side() -> None:
    """A job encodes several blocks at once, each into a file of its own in memory."""
    value = np.random.default_rng(2).integers(0, 9, (24, 24, 40)).astype(np.int8)
    alone = _written(value, 1)
    with ThreadPoolExecutor(8) as pool:
        assert all(found == alone for found in pool.map(_content, [value] * 48))
