"""Datasets at a distance: read from a URL as from a folder (by fsspec and aiohttp).

What is needed is fetched whole, when it is first needed, into a cache folder, and from then on read from there:
the manifest and the floor plan when the dataset is opened, a shard when one of its pairs is. A file is taken
only if its size and SHA-256 are those of the manifest, whose own SHA-256 is in it. What a broken connection
left is gone on with. If the server cannot be reached, the manifest in the cache serves, with a warning, so that
what was fetched is read.

What a server may cost is bounded: a file by its size in the manifest and by the free space, in time by its size
(`_LEAST_RATE`), in tries by `_TRIES`; see `web` for http and https, and docs/threats.md.
"""

from __future__ import annotations

import hashlib
import logging
import os
import shutil
import tempfile
import time
from contextlib import suppress
from pathlib import Path
from typing import Any, Protocol
from urllib.parse import urlsplit

from soundspaces_sim import ConfigError, DatasetError
from soundspaces_sim.parts import (
    MANIFEST_NAME as NAME,
    MOST_JSON,
    FileEntry,
    ShardEntry,
    cache_root,
    exclusive_file as exclusive,
    file_sha256,
    make_folder,
    publish_file as publish,
    read_manifest,
    rename_open,
)

_log = logging.getLogger(__name__)
_TRIES = 5  # of a file, in all
_PAUSE_S = 0.2  # before the second try; it doubles
_GRACE_S = 60.0  # for any file
_LEAST_RATE = 10_000.0  # bytes/s beyond that, on average over all tries
_MANIFEST_S = 300.0  # for a manifest, whose size nothing tells
_MOST_FILES = 16  # beside the shards, which are fetched when a dataset is opened
_BLOCK = 1 << 18
Entry = ShardEntry | FileEntry


class _Place(Protocol):
    """Where files lie: see `web.Web`."""

    def read(self, name: str, first: int, most: int, seconds: float, take: Any) -> None: ...


class _FileSystem:
    """The same by any file system of fsspec but the web's."""

    def __init__(self, url: str) -> None:
        self._url = url
        self._connect()

    def _connect(self) -> None:
        import fsspec

        self._system, self._root = fsspec.core.url_to_fs(self._url)
        self._process = os.getpid()

    def read(self, name: str, first: int, most: int, seconds: float, take: Any) -> None:
        if self._process != os.getpid():  # its connections and its thread stayed in the parent
            self._connect()
        deadline = time.monotonic() + seconds
        with self._system.open(f"{self._root}/{name}", "rb") as source:
            source.seek(first)
            while first < most and (block := source.read(min(_BLOCK, most - first))):
                take(first, block)
                first += len(block)
                if time.monotonic() > deadline:
                    raise TimeoutError(f"it takes more than {seconds:.0f} s")


class Remote:
    """A dataset at a URL and its copy in `folder`. Raises `ConfigError` without fsspec, `DatasetError`."""

    def __init__(self, url: str) -> None:
        self.url = url.rstrip("/")
        self._place = _place(self.url)
        self.folder = cache_root() / hashlib.sha256(self.url.encode()).hexdigest()[:32]
        make_folder(self.folder, "set SOUNDSPACES_SIM_CACHE to another place for the cache")
        self._fetch_manifest()
        files = read_manifest(self.folder).files
        if len(files) > _MOST_FILES:
            raise DatasetError(
                f"{self.url}/{NAME}: names {len(files):,} files beside the shards, where {_MOST_FILES} are the most"
            )
        for entry in files:
            self.fetch(entry)

    def fetch(self, entry: Entry) -> None:
        """Have a file of the dataset in the folder, whole. Raises `DatasetError`."""
        path = self.folder / entry.file
        if path.exists():
            return
        part = self.folder / f".{entry.file}.part"
        try:
            with exclusive(part) as target:  # one process fetches, others wait for it
                if not path.exists():
                    self._fetch(entry, target, part)
                    rename_open(target, part, path)
        except OSError as error:
            raise DatasetError(
                f"{part}: cannot write this file ({error.strerror}); free some space, or set "
                "SOUNDSPACES_SIM_CACHE to another place for the cache"
            ) from error

    def _fetch_manifest(self) -> None:
        """Take the server's manifest where it can be had; it replaces that of an older version of the dataset."""
        path = self.folder / NAME
        old = path.read_bytes() if path.exists() else None
        try:
            new = self._manifest()
        except FileNotFoundError:
            raise DatasetError(f"no dataset at {self.url}: {NAME} is missing") from None
        except Exception as error:  # whatever a file system of fsspec raises
            if old is None:
                if isinstance(error, DatasetError):
                    raise
                raise DatasetError(f"{self.url}: cannot be reached ({_words(error)})") from error
            _log.warning(
                "%s cannot be reached (%s): reading what is in %s", self.url, _words(error), self.folder
            )
            return
        if new == old:
            return
        if old is not None:
            for other in self.folder.iterdir():
                with suppress(OSError):  # another process deletes as well
                    other.unlink()
        publish(path, new)

    def _manifest(self) -> bytes:
        """The server's manifest, read and checked."""
        content = bytearray()

        def take(at: int, block: bytes) -> None:
            content[at:] = block

        deadline, pause = time.monotonic() + _MANIFEST_S, _PAUSE_S
        for last in (False, True):
            try:
                self._place.read(NAME, 0, MOST_JSON + 1, deadline - time.monotonic(), take)
                break
            except (FileNotFoundError, DatasetError):
                raise
            except Exception:
                if last:
                    raise
                time.sleep(pause)
        if len(content) > MOST_JSON:
            raise DatasetError(
                f"{self.url}/{NAME}: has more than {MOST_JSON:,} bytes, which is the limit"
            )
        with tempfile.TemporaryDirectory(prefix=".manifest", dir=self.folder.parent) as folder:
            Path(folder, NAME).write_bytes(content)
            try:
                read_manifest(Path(folder))
            except DatasetError as error:
                raise DatasetError(str(error).replace(folder, self.url)) from error
        return bytes(content)

    def _fetch(self, entry: Entry, target: Any, part: Path) -> None:
        """Fill `target`, which is `part`, with what is lacking of a file."""
        size, url = entry.bytes, f"{self.url}/{entry.file}"

        def take(at: int, block: bytes) -> None:
            if at < target.tell():
                target.truncate(at)
            target.seek(at)
            target.write(block)

        _check_room(url, size - target.seek(0, os.SEEK_END), self.folder)
        deadline, pause = time.monotonic() + _GRACE_S + size / _LEAST_RATE, _PAUSE_S
        problem, wrong = "", 0
        for _ in range(_TRIES):
            try:
                first = min(target.seek(0, os.SEEK_END), size)
                if first < size:
                    self._place.read(entry.file, first, size, deadline - time.monotonic(), take)
                problem = f"it ends after {target.tell():,} of {size:,} bytes"
            except Exception as error:
                problem = _words(error)
                if isinstance(error, FileNotFoundError | DatasetError):
                    break
            if target.tell() >= size:
                if target.tell() == size and file_sha256(part) == entry.sha256:
                    os.fsync(target.fileno())
                    return
                target.truncate(0)  # a wrong byte is fetched once more
                wrong += 1
                if wrong > 1:
                    raise DatasetError(
                        f"{url} is not what the manifest says (its SHA-256 differs): it was changed or damaged "
                        "where it lies"
                    )
                continue
            if time.monotonic() + pause > deadline:
                break
            time.sleep(pause)
            pause *= 2.0
        raise DatasetError(
            f"{url}: cannot be fetched ({problem}); {target.seek(0, os.SEEK_END):,} of {size:,} bytes are kept, "
            "and the next read goes on from there"
        )


def _place(url: str) -> _Place:
    """Raises `ConfigError` for addresses that cannot be read here."""
    kind = urlsplit(url).scheme
    try:
        if kind in ("http", "https"):
            from soundspaces_remote.web import Web  # needs aiohttp

            place: _Place = Web(url)
            return place
        if kind in ("file", "local"):
            raise ValueError("it is on this machine: give its path")
        return _FileSystem(url)
    except ModuleNotFoundError as error:
        if error.name not in ("fsspec", "aiohttp", "yarl"):
            raise ConfigError(f"{url}: cannot be read here ({error})") from error
        raise ConfigError(
            f"{url}: reading from a URL needs fsspec; in a clone: .venv/bin/pip install ./neighbours/remote"
        ) from error
    except (ImportError, ValueError) as error:
        raise ConfigError(f"{url}: cannot be read here ({error})") from error


def _check_room(url: str, wanted: int, folder: Path) -> None:
    free = shutil.disk_usage(folder).free
    if wanted > free:
        raise DatasetError(
            f"{url}: {wanted:,} bytes are to be fetched, and {free:,} are free in {folder}; free some space, or "
            "set SOUNDSPACES_SIM_CACHE to another place for the cache"
        )


def _words(error: BaseException) -> str:
    return f"{type(error).__name__}: {error}" if str(error) else type(error).__name__
