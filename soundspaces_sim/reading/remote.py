"""Datasets at a distance: read from a URL as from a folder (extra ``remote``: fsspec).

What is needed is fetched whole, when it is first needed, into a cache folder, and from then on read from there: the
manifest and the floor plan when the dataset is opened, a shard when one of its pairs is. A file is taken only if
its size and SHA-256 are those of the manifest, whose own SHA-256 is in it. What a broken connection left is gone on
with. If the server cannot be reached, the manifest in the cache serves, with a warning, so that what was fetched is
read.
"""

from __future__ import annotations

import fcntl
import hashlib
import logging
import os
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from soundspaces_sim.base.errors import ConfigError, DatasetError
from soundspaces_sim.base.extras import install_hint
from soundspaces_sim.base.files import cache_root, file_sha256, make_folder
from soundspaces_sim.files.door import MOST_JSON
from soundspaces_sim.storage.manifest import NAME, FileEntry, ShardEntry, read_manifest

_log = logging.getLogger(__name__)
_TRIES = 5
_PAUSE_S = 0.2  # before the second try; it doubles
_BLOCK = 1 << 18
Entry = ShardEntry | FileEntry


class Remote:
    """A dataset at a URL and its copy in `folder`. Raises `ConfigError` without fsspec, `DatasetError`."""

    def __init__(self, url: str) -> None:
        try:
            import fsspec
        except ImportError as error:
            raise ConfigError(
                f"{url}: reading from a URL needs fsspec: {install_hint('remote')}"
            ) from error
        self.url = url.rstrip("/")
        self.folder = cache_root() / hashlib.sha256(self.url.encode()).hexdigest()[:32]
        try:
            self._system, self._root = fsspec.core.url_to_fs(self.url)
        except (ImportError, ValueError) as error:
            raise ConfigError(f"{url}: cannot be read here ({error})") from error
        make_folder(self.folder, "set SOUNDSPACES_SIM_CACHE to another place for the cache")
        self._fetch_manifest()
        for entry in read_manifest(self.folder).files:
            self.fetch(entry)

    def fetch(self, entry: Entry) -> None:
        """Have a file of the dataset in the folder, whole. Raises `DatasetError`."""
        path = self.folder / entry.file
        if not path.exists():
            self._fetch(entry.file, entry.bytes, lambda part: file_sha256(part) == entry.sha256)

    def _fetch_manifest(self) -> None:
        """Take the server's manifest where it can be had; it replaces that of an older version of the dataset."""
        old = (self.folder / NAME).read_bytes() if (self.folder / NAME).exists() else None
        try:
            new = _patiently(lambda: self._system.cat_file(f"{self._root}/{NAME}", end=MOST_JSON), 2)
        except FileNotFoundError:
            raise DatasetError(f"no dataset at {self.url}: {NAME} is missing") from None
        except Exception as error:  # whatever a file system of fsspec raises
            if old is None:
                raise DatasetError(f"{self.url}: cannot be reached ({_words(error)})") from error
            _log.warning(
                "%s cannot be reached (%s): reading what is in %s", self.url, _words(error), self.folder
            )
            return
        if new == old:
            return
        if old is not None:
            for path in self.folder.iterdir():
                path.unlink()
        part = self.folder / f".{NAME}.part"
        part.write_bytes(new)
        part.replace(self.folder / NAME)
        try:
            read_manifest(self.folder)
        except DatasetError:
            (self.folder / NAME).unlink()
            raise

    def _fetch(self, name: str, size: int, right: Callable[[Path], bool]) -> None:
        path, part = self.folder / name, self.folder / f".{name}.part"
        with part.open("ab") as target:
            fcntl.flock(target, fcntl.LOCK_EX)  # one process fetches, others wait for it
            if path.exists():
                return
            for last in (False, True):  # a wrong byte is fetched once more
                try:
                    _patiently(lambda: self._go_on(name, target, size), _TRIES)
                except Exception as error:
                    raise DatasetError(
                        f"{self.url}/{name}: cannot be fetched ({_words(error)}); {target.tell():,} of {size:,} "
                        "bytes are kept, and the next read goes on from there"
                    ) from error
                if target.tell() == size and right(part):
                    os.fsync(target.fileno())
                    part.replace(path)
                    return
                target.truncate(0)
                if last:
                    raise DatasetError(
                        f"{self.url}/{name} is not what the manifest says (its SHA-256 differs): it was changed or "
                        "damaged where it lies"
                    )

    def _go_on(self, name: str, target: Any, size: int) -> None:
        """Append what is lacking of a file."""
        target.seek(0, os.SEEK_END)
        while target.tell() < size:
            first = target.tell()
            block = self._system.cat_file(
                f"{self._root}/{name}", start=first, end=min(first + _BLOCK, size)
            )
            if not block:
                raise OSError(f"it ends after {first:,} of {size:,} bytes")
            target.write(block[: size - first])
            target.flush()


def _patiently(action: Callable[[], Any], tries: int) -> Any:
    """Do what a network may refuse, up to `tries` times."""
    pause = _PAUSE_S
    for left in range(tries - 1, -1, -1):
        try:
            return action()
        except FileNotFoundError:
            raise
        except Exception:
            if left == 0:
                raise
        time.sleep(pause)
        pause *= 2.0
    raise AssertionError


def _words(error: BaseException) -> str:
    return f"{type(error).__name__}: {error}" if str(error) else type(error).__name__
