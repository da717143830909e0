"""What operating systems differ in: locks, flags of `open`, owners of files, memory, forks.

Each function asks whether the system has what it needs, and takes Windows' way where it has not; psutil is
installed there. Nothing here is imported that only some systems have.
"""

from __future__ import annotations

import errno
import getpass
import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from typing import Any, BinaryIO

try:
    fcntl: Any = import_module("fcntl")
    resource: Any = import_module("resource")
except ImportError:  # Windows
    fcntl = resource = None

_OF_OTHERS = 0o022  # may write


def open_flags(access: int, follow: bool = True) -> int:
    """Flags of `os.open`: not inherited, never waiting for a FIFO, bytes as they are, no symbolic link unless
    `follow`, so far as the system has them."""
    names = ["O_CLOEXEC", "O_NOINHERIT", "O_NONBLOCK", "O_BINARY"] + ([] if follow else ["O_NOFOLLOW"])
    for name in names:
        access |= getattr(os, name, 0)
    return access


def refuse_link(path: Path) -> None:
    """Raise OSError (ELOOP) for a symbolic link where `open` knows no O_NOFOLLOW."""
    if not hasattr(os, "O_NOFOLLOW") and path.is_symlink():
        raise OSError(errno.ELOOP, os.strerror(errno.ELOOP), str(path))


@contextmanager
def exclusive(path: Path) -> Iterator[BinaryIO]:
    """A file, made if need be, open for reading and writing by one process at a time; others wait.

    Windows does not rename a file that is open, so there a file beside it is locked. Raises OSError.
    """
    flags = open_flags(os.O_RDWR | os.O_CREAT, follow=False)
    if fcntl is not None:
        with os.fdopen(os.open(path, flags, 0o666), "r+b", buffering=0) as file:
            fcntl.flock(file, fcntl.LOCK_EX)
            yield file
        return
    msvcrt = import_module("msvcrt")
    with open(path.with_name(f"{path.name}.lock"), "a+b") as guard:
        _lock(msvcrt, guard)
        try:
            refuse_link(path)
            with os.fdopen(os.open(path, flags, 0o666), "r+b", buffering=0) as file:
                yield file
        finally:
            guard.seek(0)
            msvcrt.locking(guard.fileno(), msvcrt.LK_UNLCK, 1)


def _lock(msvcrt: Any, guard: BinaryIO) -> None:
    """Wait for a lock on the first byte; a call of Windows' gives up after ten seconds."""
    while True:
        guard.seek(0)
        try:
            msvcrt.locking(guard.fileno(), msvcrt.LK_LOCK, 1)
            return
        except OSError as error:
            if error.errno not in (errno.EDEADLK, errno.EACCES):
                raise


def rename_open(file: BinaryIO, old: Path, new: Path) -> None:
    """Give an open file that is `exclusive` its name; it may be closed before."""
    if fcntl is None:
        file.close()
    old.replace(new)


def user_name() -> str:
    """What tells this user from others: a number, on Windows a name."""
    return str(os.geteuid()) if hasattr(os, "geteuid") else getpass.getuser()


def is_own(state: os.stat_result) -> bool:
    """Whether a file belongs to this user (or root) and nobody else may write it. Where files have no such
    owners, access to the folder of the user's profile is what guards them."""
    if not hasattr(os, "geteuid"):
        return True
    return state.st_uid in (os.geteuid(), 0) and not state.st_mode & _OF_OTHERS


def sync_folder(folder: Path) -> None:
    """Wait until names in a folder are on disk, where folders can be opened."""
    if not hasattr(os, "O_DIRECTORY"):
        return
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def reserve(handle: int, size: int) -> None:
    """Set room on the disk aside for an open file, where the system can be asked to: a mapping that is written to
    without ends the process. Raises OSError."""
    if hasattr(os, "posix_fallocate"):
        os.posix_fallocate(handle, 0, size)


def sync_all() -> None:
    """Wait until all files are on disk, where the system can be asked to: once for many files, where each `fsync`
    costs a journal."""
    if hasattr(os, "sync"):
        os.sync()


def at_fork(before: Callable[[], None], parent: Callable[[], None], child: Callable[[], None]) -> None:
    """Call these about forks, where processes fork."""
    if hasattr(os, "register_at_fork"):
        os.register_at_fork(before=before, after_in_parent=parent, after_in_child=child)


def process_runs(process: int) -> bool:
    """Whether a process of this machine exists and has not ended; a zombie has ended."""
    if sys.platform == "win32":  # where signal 0 is Ctrl-C
        psutil = import_module("psutil")
        return bool(psutil.pid_exists(process))
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except PermissionError:
        return True
    try:
        state = Path(f"/proc/{process}/stat").read_text().rsplit(")", 1)[1].split()[0]
    except (OSError, IndexError):
        return True  # not Linux
    return state != "Z"


def machine_memory() -> float:
    """Bytes of the machine that are free, or, where nobody tells, all of it."""
    if not hasattr(os, "sysconf"):
        return float(import_module("psutil").virtual_memory().available)
    try:
        lines = Path("/proc/meminfo").read_text(encoding="ascii").splitlines()
        (line,) = (line for line in lines if line.startswith("MemAvailable:"))
        return float(int(line.split()[1]) * 1024)
    except (OSError, ValueError):  # not Linux
        return float(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES"))


def peak_memory_mb() -> float:
    """Largest resident size of this process so far; macOS counts in bytes, Linux in kB."""
    if resource is None:
        return float(import_module("psutil").Process().memory_info().peak_wset) / 1e6
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return float(peak) / (1e6 if sys.platform == "darwin" else 1e3)
