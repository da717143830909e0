"""The door for files that others made: regular files, of bounded size, as bytes, text, JSON or TOML.

A FIFO would hang and a device would never end, so only regular files are opened; inside a dataset's folder
(`follow=False`) no symbolic link is followed either, because it may lead to what the folder's maker could not
read. HDF5 files have a door of their own, `hdf5`.
"""

from __future__ import annotations

import errno
import json
import math
import os
import re
import stat
import tomllib
from pathlib import Path
from typing import Any, BinaryIO

from soundspaces_sim.core.errors import SoundSpacesSimError
from soundspaces_sim.core.platforms import open_flags, refuse_link

_MOST_DIGITS = 300
MOST_JSON = 256 * 2**20  # bytes
MOST_TOML = 2**20
_MOST_DOTS = 100  # of a key: tomllib takes quadratic time and memory
_KEYS = re.compile(r"[^,=\[\]{}\n]+")


def open_regular(
    path: Path, error: type[SoundSpacesSimError], what: str, follow: bool = True, verb: str = "read"
) -> BinaryIO:
    """A regular file, open for reading; `what` it should be, and what is done with it, for messages.
    Raises `error`."""
    try:
        if not follow:
            refuse_link(path)
        handle = os.open(path, open_flags(os.O_RDONLY, follow))
    except (OSError, ValueError) as problem:
        if isinstance(problem, OSError) and problem.errno == errno.ELOOP and not follow:
            raise error(
                f"{path}: a symbolic link; files of a dataset must lie in its folder (copy it with `cp -rL`)"
            ) from problem
        raise error(
            f"{path}: cannot {verb} this {what} ({getattr(problem, 'strerror', None) or problem})"
        ) from problem
    if not stat.S_ISREG(os.fstat(handle).st_mode):
        os.close(handle)
        raise error(f"{path}: cannot {verb} this {what}: it is not a regular file")
    return os.fdopen(handle, "rb")


def size_of(file: BinaryIO) -> int:
    """Bytes of an open file."""
    return os.fstat(file.fileno()).st_size


def read_bytes(
    path: Path | str, error: type[SoundSpacesSimError], what: str, most: int, follow: bool = True
) -> bytes:
    """The bytes of a regular file of at most `most` bytes. Raises `error`."""
    path = Path(path)
    with open_regular(path, error, what, follow) as file:
        try:
            data = file.read(min(size_of(file), most) + 1)
        except OSError as problem:
            raise error(f"{path}: cannot read this {what} ({problem.strerror})") from problem
    if len(data) > most:
        raise error(f"{path}: this {what} has more than {most:,} bytes, which is the limit")
    return data


def read_text(
    path: Path | str, error: type[SoundSpacesSimError], what: str, most: int, follow: bool = True
) -> str:
    """The same as UTF-8 text."""
    try:
        return read_bytes(path, error, what, most, follow).decode("utf-8")
    except UnicodeDecodeError as problem:
        raise error(f"{path}: this {what} is not UTF-8 text ({problem})") from problem


def read_json(
    path: Path | str,
    error: type[SoundSpacesSimError],
    what: str,
    most: int = MOST_JSON,
    follow: bool = True,
) -> Any:
    """The parsed JSON of a regular file; NaN and Infinity, which JSON does not have, are refused."""
    return parse_json(read_text(path, error, what, most, follow), path, error, what)


def read_toml(path: Path | str, error: type[SoundSpacesSimError], what: str) -> dict[str, Any]:
    """The parsed TOML of a regular file. Raises `error`."""
    text = read_text(path, error, what, MOST_TOML)
    if any(piece.count(".") > _MOST_DOTS for piece in _KEYS.findall(text)):
        raise error(f"{path}: a key has more than {_MOST_DOTS} parts")
    try:
        return tomllib.loads(text)
    except RecursionError as problem:
        raise error(f"{path}: not valid TOML: nested too deeply") from problem
    except ValueError as problem:  # TOMLDecodeError, or a number of thousands of digits
        raise error(f"{path}: not valid TOML: {problem}") from problem


def parse_json(text: str, path: Path | str, error: type[SoundSpacesSimError], what: str) -> Any:
    """Parsed JSON of a text that was read from `path`; its numbers are finite as floats. Raises `error`."""

    def refuse(constant: str) -> None:
        raise ValueError(f"{constant} is not JSON")

    def whole(digits: str) -> int:
        if len(digits) > _MOST_DIGITS:
            raise ValueError(f"a whole number has {len(digits)} digits; {_MOST_DIGITS} is the most")
        return int(digits)

    def real(digits: str) -> float:
        number = float(digits)
        if not math.isfinite(number):
            raise ValueError(f"{digits[:40]} is beyond what a number can be")
        return number

    try:
        return json.loads(text, parse_constant=refuse, parse_int=whole, parse_float=real)
    except RecursionError as problem:
        raise error(f"{path}: this {what} is nested too deeply") from problem
    except ValueError as problem:
        raise error(f"{path}: this {what} is not valid JSON: {problem}") from problem
