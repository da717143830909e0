"""Disk cache of what is expensive to compute for a scene.

A file holds arrays, no pickles, under the digest of what they are made of: the caller's key, the code, the
libraries that round, the kind of CPU and the user, so that they are, to the bit, what would be made here. It is
sealed with a digest of that name and the arrays, and read only if it belongs to this user (or root) and nobody
else may write it: what others lay there is not believed, and in a folder that users share each has files of
their own. What kernels index with is checked by the caller besides. A file that is damaged, forged or cannot be
read is made again. What cannot be written is not kept. Beyond `_MOST` bytes those go that were not used for
longest.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import logging
import math
import os
import time
from collections.abc import Callable
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any, TypeVar, get_type_hints

import msgspec
import numpy as np

from soundspaces_sim.core.embree_library import ray_engine_name
from soundspaces_sim.core.errors import DatasetError, SoundSpacesSimError
from soundspaces_sim.core.io.files import cache_root, make_folder, publish
from soundspaces_sim.core.io.untrusted import open_regular, size_of
from soundspaces_sim.core.numerics.kernel import source_digest
from soundspaces_sim.core.numerics.target import code_target
from soundspaces_sim.core.platforms import is_own, user_name

_log = logging.getLogger(__name__)
_Arrays = TypeVar("_Arrays", bound=tuple[Any, ...])
_MOST = 2**31  # bytes of all files
_SEAL = 32  # bytes of a digest
_ALIGNED = 64  # bytes
_MOST_HEAD = 2**16  # bytes of the line that describes the arrays
_WORTH_S = 0.5  # what is made sooner is not kept
_ROUND = ("numpy", "scipy", "numba", "trimesh")
_TYPES = ("<f8", "<f4", "<i8", "<i4", "<u2", "|u1", "|b1")


def cached_on_disk(
    like: type[_Arrays],
    key: tuple[object, ...],
    make: Callable[[], _Arrays],
    fits: Callable[[_Arrays], bool],
) -> _Arrays:
    """`make()`, a `NamedTuple` of arrays or of such tuples, or what it gave for the same key before.

    `key`: whatever decides the result beside code and machine, as objects whose `repr` tells them apart.
    `fits`: whether what was read may be used: types, shapes, and indices within what they index.
    """
    name = hashlib.sha256(repr((like.__qualname__, key, _engine(), user_name())).encode()).hexdigest()
    try:
        path = cache_root() / "scenes" / f"{name}.arrays"
    except SoundSpacesSimError as problem:
        _log.warning("nothing is kept for the next time: %s", problem)
        return make()
    found = _read(path, like, fits)
    if found is not None:
        return found
    start = time.perf_counter()
    made = make()
    if time.perf_counter() - start > _WORTH_S:
        _write(path, made)
    return made


def fingerprint(*arrays: np.ndarray) -> str:
    """Digest of arrays, their types and shapes, for keys."""
    sha = hashlib.sha256()
    for array in arrays:
        sha.update(repr((array.dtype.str, array.shape)).encode())
        sha.update(np.ascontiguousarray(array).data)
    return sha.hexdigest()


@cache
def _engine() -> tuple[str, ...]:
    return source_digest(), code_target(), ray_engine_name(), *(version(name) for name in _ROUND)


def _read(path: Path, like: type[_Arrays], fits: Callable[[_Arrays], bool]) -> _Arrays | None:
    if not os.path.lexists(path):
        return None
    try:
        content = _content(path)
        if content[:_SEAL].tobytes() != _seal(path, content[_SEAL:].data):
            raise ValueError("its digest differs")
        tree: _Arrays = _tree(like, _unpacked(content, _SEAL), "")
        if not fits(tree):
            raise ValueError("its arrays do not fit the scene")
    except (
        OSError,
        ValueError,
        LookupError,
        TypeError,
        MemoryError,
        msgspec.MsgspecError,
        DatasetError,
    ) as problem:
        _log.warning("%s: made again, because it cannot be used (%s)", path, problem)
        return None
    with contextlib.suppress(OSError):  # a file system that is only read
        os.utime(path)
    _log.debug("%s: as it was made before", path)
    return tree


def _content(path: Path) -> np.ndarray:
    """Raises `ValueError` for a file of somebody else."""
    with open_regular(path, DatasetError, "file of the cache", follow=False) as file:
        if not is_own(os.fstat(file.fileno())):
            raise ValueError("others than this user could write it")
        if size_of(file) > _MOST:
            raise ValueError(f"it has more than {_MOST:,} bytes")
        return np.fromfile(file, np.uint8)


def _seal(path: Path, *content: Any) -> bytes:
    """Digest of the name and the content: a file that was renamed is another scene's."""
    sha = hashlib.sha256(path.stem.encode())
    for part in content:
        sha.update(part)
    return sha.digest()


def _write(path: Path, made: tuple[Any, ...]) -> None:
    parts = _packed(_flat(made, ""))
    if sum(memoryview(part).nbytes for part in parts) > _MOST:
        return
    try:
        make_folder(path.parent)
        publish(path, b"".join([_seal(path, *parts), *parts]), durable=False, mode=0o600)
    except DatasetError as problem:
        _log.warning("not kept for the next time: %s", problem)
        return
    _prune(path.parent)


def _packed(arrays: dict[str, np.ndarray]) -> list[Any]:
    """A line of JSON, [name, type, shape] of each array, and their bytes; the first begins aligned after a seal."""
    little = {n: np.ascontiguousarray(a, a.dtype.newbyteorder("<")) for n, a in arrays.items()}
    head = json.dumps([[n, a.dtype.str, a.shape] for n, a in little.items()]).encode()
    head += b" " * (-(_SEAL + len(head) + 1) % _ALIGNED) + b"\n"
    return [head, *(a.ravel().view(np.uint8).data for a in little.values())]


def _unpacked(content: np.ndarray, at: int) -> dict[str, np.ndarray]:
    """What `_packed` packed, from byte `at` on. Raises `ValueError` and msgspec's errors."""
    head_bytes = content[at : at + _MOST_HEAD].tobytes()
    end = at + head_bytes.index(b"\n")
    head = msgspec.json.decode(head_bytes[: end - at], type=list[tuple[str, str, tuple[int, ...]]])
    out, at = {}, end + 1
    for name, kind, shape in head:
        count = math.prod(shape)
        if kind not in _TYPES or not all(0 <= n <= _MOST for n in shape) or count > _MOST:
            raise ValueError(f"an array of type {kind} and shape {shape}")
        array = np.frombuffer(content, kind, count, at) if count else np.empty(0, kind)
        out[name] = (array if array.flags.aligned else array.copy()).reshape(shape)
        at += array.nbytes
    if at != len(content):
        raise ValueError(f"it has {len(content):,} bytes, where its arrays have {at:,}")
    return out


def _prune(folder: Path) -> None:
    """Delete those files that were not used for longest, until the rest fit."""
    files = []
    with contextlib.suppress(OSError):  # somebody else deletes as well
        for path in folder.iterdir():
            state = path.lstat()
            files.append((state.st_mtime_ns, state.st_size, path))
    total = 0
    for _, size, path in sorted(files, reverse=True):
        total += size
        if total > _MOST:
            with contextlib.suppress(OSError):
                path.unlink()


def _flat(tree: tuple[Any, ...], prefix: str) -> dict[str, np.ndarray]:
    out: dict[str, np.ndarray] = {}
    for name, value in zip(tree._fields, tree, strict=True):  # type: ignore[attr-defined]
        here = f"{prefix}{name}"
        out.update(_flat(value, f"{here}.") if isinstance(value, tuple) else {here: value})
    return out


def _tree(like: type[Any], arrays: dict[str, np.ndarray], prefix: str) -> Any:
    """Raises `KeyError` if an array is missing."""
    return like(
        *(
            _tree(kind, arrays, f"{prefix}{name}.")
            if issubclass(kind, tuple)
            else arrays[f"{prefix}{name}"]
            for name, kind in get_type_hints(like).items()
        )
    )
