"""What takes long to make of a scene, kept on disk from one process to the next.

A file holds arrays, no pickles, under the digest of what they are made of: the caller's key, the code, the
libraries that round, and the kind of CPU, so that they are, to the bit, what would be made here. One that is
damaged or cannot be read is made again. What cannot be written is not kept. Beyond `_MOST` bytes those go that were
not used for longest.
"""

from __future__ import annotations

import contextlib
import hashlib
import io
import logging
import os
import time
from collections.abc import Callable
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any, TypeVar, get_type_hints

import numpy as np

from soundspaces_sim.base.errors import DatasetError
from soundspaces_sim.base.files import cache_root, make_folder, publish
from soundspaces_sim.base.kernel import source_digest
from soundspaces_sim.base.target import code_target
from soundspaces_sim.files.door import read_bytes

_log = logging.getLogger(__name__)
_Arrays = TypeVar("_Arrays", bound=tuple[Any, ...])
_MOST = 2**31  # bytes of all files
_WORTH_S = 0.5  # what is made sooner is not kept
_ROOMS = ("base", "rays", "scene", "transport")  # whose code makes what is kept
_ROUND = ("numpy", "scipy", "numba", "embreex", "trimesh")


def kept(like: type[_Arrays], key: tuple[object, ...], make: Callable[[], _Arrays]) -> _Arrays:
    """`make()`, a `NamedTuple` of arrays or of such tuples, or what it gave for the same key before.

    `key`: whatever decides the result beside code and machine, as objects whose `repr` tells them apart.
    """
    name = hashlib.sha256(repr((like.__qualname__, key, _engine())).encode()).hexdigest()
    path = cache_root() / "scenes" / f"{name}.npz"
    found = _read(path, like)
    if found is not None:
        return found
    start = time.perf_counter()
    made = make()
    if time.perf_counter() - start > _WORTH_S:
        _write(path, made)
    return made


@cache
def _engine() -> tuple[str, ...]:
    return source_digest(_ROOMS), code_target(), *(version(name) for name in _ROUND)


def _read(path: Path, like: type[_Arrays]) -> _Arrays | None:
    if not path.is_file():
        return None
    try:
        content = read_bytes(path, DatasetError, "file of the cache", _MOST)
        digest, content = content[:32], content[32:]
        if hashlib.sha256(content).digest() != digest:
            raise ValueError("its digest differs")
        with np.load(io.BytesIO(content), allow_pickle=False) as file:
            tree = _tree(like, {n: file[n] for n in file.files}, "")
        os.utime(path)
    except (OSError, ValueError, LookupError, DatasetError) as problem:
        _log.warning("%s: made again, because it cannot be read (%s)", path, problem)
        return None
    _log.debug("%s: as it was made before", path)
    return tree


def _write(path: Path, made: tuple[Any, ...]) -> None:
    content = io.BytesIO()
    np.savez(content, allow_pickle=False, **_flat(made, ""))
    digest = hashlib.sha256(content.getbuffer()).digest()
    try:
        make_folder(path.parent)
        publish(path, b"".join([digest, content.getbuffer()]), durable=False)
    except DatasetError as problem:
        _log.warning("not kept for the next time: %s", problem)
        return
    _prune(path.parent)


def _prune(folder: Path) -> None:
    """Delete those files that were not used for longest, until the rest fit."""
    files = []
    for path in folder.glob("*.npz"):
        with contextlib.suppress(OSError):  # somebody else deletes as well
            files.append((path.stat().st_mtime_ns, path.stat().st_size, path))
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
