"""The door for HDF5 files: only what lies in the file itself, and no more than it holds.

HDF5 can name other files (external storage, external links, virtual datasets), point elsewhere (soft links),
and declare arrays of any size of which nothing is stored. Here a dataset is reached by a hard link, its
numbers are stored in the file, all of them, and it is at most `MOST_RATIO` times as large as what is stored,
which is what deflate can reach; all this is looked at before anything is read.
"""

from __future__ import annotations

import io
import itertools
import math
import mmap
import operator
import struct
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from soundspaces_sim.core.errors import DatasetError, SoundSpacesSimError
from soundspaces_sim.core.io.untrusted import open_regular

#: gzip, shuffle, fletcher32; and of hdf5plugin: blosc, lz4, bitshuffle, zstd, blosc2.
FILTERS = {1, 2, 3, 32001, 32004, 32008, 32015, 32026}
MOST_RATIO = 1032
MOST_CHUNKS = 2**22
_SHUFFLE, _FLETCHER32 = 2, 3
_LAYOUTS = (h5py.h5d.COMPACT, h5py.h5d.CONTIGUOUS, h5py.h5d.CHUNKED)
_MOST_TEXT = 2**20  # bytes of an attribute
_UNREADABLE = (
    f"HDF5 {h5py.version.hdf5_version} wrote it just now, and nothing was kept: install another h5py"
)


def open_hdf5(
    source: Path | bytes, error: type[SoundSpacesSimError], what: str, remedy: str, follow: bool = True
) -> h5py.File:
    """An HDF5 file, open for reading, without a chunk cache. Raises `error`.

    Without a lock: files here are published whole and never written again, and some network file systems have none.
    """
    if isinstance(source, Path):
        open_regular(source, error, what, follow, "open").close()
    try:
        return h5py.File(
            source if isinstance(source, Path) else io.BytesIO(source), "r", rdcc_nbytes=0, locking=False
        )
    except Exception as problem:  # the library raises whatever it met
        raise error(f"{_name(source)}: cannot open this {what} ({problem}); {remedy}") from problem


def create_hdf5(content: io.BytesIO) -> h5py.File:
    """An HDF5 file to be written; `content` is whole when it has been closed, and then for `written`.

    From 1.10 on HDF5 keeps a checksum of all that it says of the data. The image of a file that is still open
    (H5Fget_file_image) has a wrong one in its first block before HDF5 2.0: no version can open it.
    """
    return h5py.File(content, "w", libver=("v110", "v110"))


def written(content: io.BytesIO, what: str, check: Callable[[h5py.File], object] | None = None) -> bytes:
    """The bytes of a file that was closed, once they could be opened again; `check` raises what is wrong with them,
    by default that a dataset is not stored whole. Raises `DatasetError`."""
    data = content.getvalue()
    with open_hdf5(data, DatasetError, what, _UNREADABLE) as file:
        if check is not None:
            check(file)
        else:
            for name in file:
                plain_dataset(file, name, what, DatasetError, _UNREADABLE)
    return data


def _name(source: Path | bytes) -> str:
    return str(source) if isinstance(source, Path) else "file in memory"


@contextmanager
def in_our_words(where: str, error: type[SoundSpacesSimError], remedy: str) -> Iterator[None]:
    """What HDF5 raises about a damaged file, of whatever kind, as `error`."""
    try:
        yield
    except SoundSpacesSimError:
        raise
    except Exception as problem:
        raise error(f"{where} is damaged ({type(problem).__name__}: {problem}); {remedy}") from problem


def plain_dataset(
    file: h5py.File, name: str, where: str, error: type[SoundSpacesSimError], remedy: str
) -> h5py.Dataset:
    """A dataset of numbers that is stored in this file, whole. Raises `error`; reads nothing of it."""
    what = f"{where}: dataset '{name}'"
    with in_our_words(what, error, remedy):
        key = name.encode()
        if key not in file.id:
            raise error(f"{what} is missing")
        if file.id.links.get_info(key).type != h5py.h5l.TYPE_HARD:
            raise error(f"{what} is a link to somewhere else; files must hold what they are read for")
        if h5py.h5o.get_info(file.id, key).type != h5py.h5o.TYPE_DATASET:
            raise error(f"{what} is no dataset")
        found = h5py.h5d.open(file.id, key)
        plan = found.get_create_plist()
        if plan.get_layout() not in _LAYOUTS or plan.get_external_count():
            raise error(f"{what} lies in other files; files must hold what they are read for")
        if found.get_type().get_class() not in (h5py.h5t.INTEGER, h5py.h5t.FLOAT):
            raise error(f"{what} does not consist of plain numbers")
        filters = [plan.get_filter(i)[0] for i in range(plan.get_nfilters())]
        lacking = [n for n in filters if not h5py.h5z.filter_avail(n)] if set(filters) <= FILTERS else []
        if lacking:
            raise error(
                f"{what} needs an HDF5 filter that is not installed ({', '.join(map(str, lacking))}); "
                "`pip install hdf5plugin` and import it first"
            )
        if len(set(filters)) < len(filters):  # inflated twice, a byte would become a million
            raise error(f"{what} uses an HDF5 filter twice")
        if not set(filters) <= FILTERS:
            raise error(
                f"{what} needs HDF5 filter {max(set(filters) - FILTERS)}, which is not supported"
            )
        _check_size(found, plan, file, what, error)
        return h5py.Dataset(found)


def _check_size(
    found: Any, plan: Any, file: h5py.File, what: str, error: type[SoundSpacesSimError]
) -> None:
    space = found.get_space()
    shape = space.shape
    if shape is None:
        raise error(f"{what} has no shape")
    declared = math.prod(shape) * found.get_type().get_size()
    if declared == 0:
        return
    if plan.get_layout() == h5py.h5d.CHUNKED:
        chunk = plan.get_chunk()
        chunks = math.prod(-(-n // c) for n, c in zip(shape, chunk, strict=True))
        declared = chunks * math.prod(chunk) * found.get_type().get_size()
    stored = found.get_storage_size()
    if stored > file.id.get_filesize() or declared > MOST_RATIO * stored:
        raise error(
            f"{what} declares {declared:,} bytes, of which {stored:,} are stored in a file of "
            f"{file.id.get_filesize():,}"
        )
    if plan.get_layout() == h5py.h5d.CHUNKED:
        if not found.get_num_chunks() == chunks <= MOST_CHUNKS:
            raise error(
                f"{what} has {found.get_num_chunks():,} chunks of its {chunks:,}; {MOST_CHUNKS:,} is the most"
            )
        problem = _bad_chunk(found, plan, shape, file.id.get_filesize())
        if problem:
            raise error(f"{what} is damaged: {problem}")


def _bad_chunk(found: Any, plan: Any, shape: tuple[int, ...], end: int) -> str:
    """What is wrong with the list of chunks, empty if nothing is: the library (2.0) can crash where two have one
    place, or one is shorter than its filters make it."""
    infos: list[Any] = []
    found.chunk_iter(infos.append)
    chunk = plan.get_chunk()
    places, masks, begins, sizes = zip(*infos, strict=True)
    grid = (range(0, n, c) for n, c in zip(shape, chunk, strict=True))
    if places != tuple(itertools.product(*grid)):  # every kind of list is in this order
        return "its chunks do not each have a place of their own"
    if min(begins) <= 0 or max(map(operator.add, begins, sizes)) > end:
        return "a chunk lies beyond the end of the file"
    filters = [plan.get_filter(i)[0] for i in range(plan.get_nfilters())]
    whole = math.prod(chunk) * found.get_type().get_size()
    for mask, size in set(zip(masks, sizes, strict=True)):
        applied = {f for i, f in enumerate(filters) if not mask >> i & 1}
        if _FLETCHER32 in filters and _FLETCHER32 not in applied:
            return "a chunk has no checksum"
        kept = size - 4 * (_FLETCHER32 in filters)
        if kept <= 0 or (kept != whole and not applied - {_SHUFFLE, _FLETCHER32}):
            return "a chunk is too short"
    return ""


def read_numbers(
    item: h5py.Dataset, where: Any, what: str, error: type[SoundSpacesSimError], remedy: str
) -> np.ndarray:
    """A dataset of `plain_dataset`, or a part of it. Raises `error` if what is stored is damaged."""
    with in_our_words(what, error, remedy):
        return np.asarray(item[where])


def attribute(
    owner: h5py.File | h5py.Dataset, name: str, where: str, error: type[SoundSpacesSimError], remedy: str
) -> str | int | float | None:
    """An attribute that is one number or a text; None if there is none of this name or it is empty. Raises
    `error`."""
    value = _attribute(owner, name, 1, f"{where}: attribute '{name}'", error, remedy)
    return None if value is None else value[0]


def numbers(
    owner: h5py.File | h5py.Dataset,
    name: str,
    count: int,
    where: str,
    error: type[SoundSpacesSimError],
    remedy: str,
) -> np.ndarray:
    """An attribute of `count` numbers, (count,) float64. Raises `error` if it is missing or something else."""
    what = f"{where}: attribute '{name}'"
    value = _attribute(owner, name, count, what, error, remedy)
    if value is None or any(isinstance(x, str) for x in value):
        raise error(f"{what} is missing, or not {count} numbers; {remedy}")
    return np.array(value, float)


def _attribute(
    owner: Any, name: str, count: int, what: str, error: type[SoundSpacesSimError], remedy: str
) -> list[Any] | None:
    with in_our_words(what, error, remedy):
        if not h5py.h5a.exists(owner.id, name.encode()):
            return None
        found = h5py.h5a.open(owner.id, name.encode())
        kind = found.get_type()
        if found.get_space().get_simple_extent_type() == h5py.h5s.NULL:  # an empty text of netCDF
            return None
        kinds = (h5py.h5t.INTEGER, h5py.h5t.FLOAT, h5py.h5t.STRING)
        if kind.get_class() not in kinds or math.prod(found.get_space().shape or ()) != count:
            raise error(f"{what} is not {'one number or a text' if count == 1 else f'{count} numbers'}")
        if found.get_storage_size() > _MOST_TEXT:
            raise error(f"{what} has more than {_MOST_TEXT:,} bytes")
        if kind.get_class() == h5py.h5t.STRING and kind.is_variable_str():
            _check_heaps(owner.file, what, error)
        values = np.ravel(owner.attrs[name])
        return [
            x.decode("utf-8", errors="replace") if isinstance(x, bytes) else x for x in values.tolist()
        ]


def put_text(file: h5py.File, name: str, text: str | bytes) -> None:
    """Write an attribute, as text of fixed length: it lies where HDF5 keeps checksums, in no global heap."""
    content = text.encode() if isinstance(text, str) else text
    file.attrs.create(name, content, dtype=h5py.string_dtype("utf-8", max(len(content), 1)))


def _check_heaps(file: h5py.File, what: str, error: type[SoundSpacesSimError]) -> None:
    """Raise `error` if a global heap, where HDF5 keeps texts of any length, has a free space of no size: the
    library (2.0) would look for its end for ever. Reads the whole file; ours have texts of fixed length.

    HDF5 File Format Specification 3.0, III.E.
    """
    data = _content(file)
    at = data.find(b"GCOL\x01\0\0\0")
    while at >= 0:
        (size,) = struct.unpack_from("<Q", data, at + 8)
        place, end = at + 16, min(at + size, len(data))
        while place + 16 <= end:
            index, _, _, length = struct.unpack_from("<HHIQ", data, place)
            if index == 0 and length == 0:
                raise error(f"{what} cannot be read: the file's texts are damaged")
            place += length if index == 0 else 16 + -(-length // 8) * 8
        at = data.find(b"GCOL\x01\0\0\0", at + 8)


def _content(file: h5py.File) -> Any:
    if file.driver == "fileobj":
        return file.id.get_file_image()
    with open(file.filename, "rb") as source:
        return mmap.mmap(source.fileno(), 0, access=mmap.ACCESS_READ)
