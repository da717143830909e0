"""Files that are whole or absent: written under a unique temporary name, flushed, renamed."""

from __future__ import annotations

import hashlib
import os
import secrets
import shutil
import socket
from functools import partial
from pathlib import Path

from soundspaces_sim.core.errors import ConfigError, DatasetError
from soundspaces_sim.core.platforms import process_runs, sync_folder


def cache_root() -> Path:
    """Where what can be had again lies: SOUNDSPACES_SIM_CACHE, else XDG_CACHE_HOME or ~/.cache, soundspaces_sim.
    Raises `ConfigError` if the user has no home folder and neither is set."""
    own = os.environ.get("SOUNDSPACES_SIM_CACHE")
    if own:
        return Path(own)
    try:
        return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "soundspaces_sim"
    except RuntimeError as error:
        raise ConfigError(
            "no place for a cache: this user has no home folder; set SOUNDSPACES_SIM_CACHE to a folder"
        ) from error


def publish(path: Path, content: bytes, durable: bool = True, mode: int = 0o666) -> None:
    """Make `content` the file `path`, durably and at once. Raises `DatasetError`.

    `mode`: who may read and write it, as far as the process allows (umask). A caller that writes many files
    leaves `durable` out and calls `platforms.sync_all` at the end.

    HDF5 files come here as bytes: the library itself never meets a full disk, which can crash it.
    """
    temporary = path.with_name(  # which is no longer than a long name itself can be
        f".{path.name[:20]}.{socket.gethostname()}.{os.getpid()}.{secrets.token_hex(4)}.partial"
    )
    check_target(path)
    try:
        free = shutil.disk_usage(path.parent).free
        if free < len(content):
            raise OSError(f"{free / 1e6:.1f} MB are free, {len(content) / 1e6:.1f} MB needed")
        try:
            with open(temporary, "xb", buffering=0, opener=partial(os.open, mode=mode)) as file:
                view = memoryview(content)
                while view:
                    view = view[file.write(view) :]
                if durable:
                    os.fsync(file.fileno())
            os.replace(temporary, path)
        except BaseException:
            temporary.unlink(missing_ok=True)
            raise
        if durable:
            sync_folder(path.parent)
    except OSError as error:
        raise DatasetError(
            f"{path}: cannot write this file ({error}); finished files are safe: free some space or "
            "choose another place, and run the same command again"
        ) from error


def check_target(path: Path) -> None:
    """Raise `DatasetError` if something at `path` would be replaced by a file that is none itself: a device, a
    FIFO, a folder, or a link to one."""
    if os.path.lexists(path) and not os.path.isfile(path):
        raise DatasetError(
            f"{path}: cannot write this file: what is there is no regular file; choose another place"
        )


def make_folder(path: Path, remedy: str = "choose another place") -> Path:
    """A folder, made if need be. Raises `DatasetError`, which says `remedy`."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise DatasetError(f"{path}: cannot make this folder ({error.strerror}); {remedy}") from error
    return path


def remove_stale(folder: Path) -> None:
    """Delete temporary files that processes of this machine left behind when they were killed."""
    for path in folder.glob(f".*.{socket.gethostname()}.*.partial"):
        process = path.name.split(".")[-3]
        if process.isdigit() and not process_runs(int(process)):
            delete(path)


def delete(path: Path) -> None:
    """Delete a file, if it is there. Raises `DatasetError`."""
    try:
        path.unlink(missing_ok=True)
    except OSError as error:
        raise DatasetError(
            f"{path}: cannot delete this file ({error.strerror}); delete it, and run the same command again"
        ) from error


def file_sha256(path: Path) -> str:
    """SHA-256 of a file's bytes, as hex. Raises `DatasetError`."""
    try:
        with open(path, "rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        raise DatasetError(f"{path}: cannot read this file ({error.strerror})") from error
