"""`verify`: is a dataset on disk what its manifest says?"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import h5py

from soundspaces_sim.base.errors import DatasetError
from soundspaces_sim.base.files import file_sha256
from soundspaces_sim.storage import schema
from soundspaces_sim.storage.manifest import Manifest, read_manifest


@dataclass(frozen=True)
class Problem:
    """What is wrong with a file."""

    file: str
    what: str


def verify_dataset(folder: str | Path, full: bool = False) -> tuple[Manifest, list[Problem]]:
    """The manifest, and what is wrong: files missing, of another size, unreadable, not of the schema.

    `full` also compares every file's SHA-256, which finds any changed byte. Raises `DatasetError` if
    there is no manifest to compare with.
    """
    folder = Path(folder)
    manifest = read_manifest(folder)
    if not manifest.complete:
        raise DatasetError(f"{folder}: this dataset is not finished; {rebuild_hint(manifest)} to go on")
    problems = []
    for entry in manifest.shards:
        path = folder / entry.file
        if not path.is_file():
            problems.append(Problem(entry.file, "is missing"))
        elif path.stat().st_size != entry.bytes:
            problems.append(
                Problem(entry.file, f"has {path.stat().st_size} bytes, expected {entry.bytes}")
            )
        elif full and file_sha256(path) != entry.sha256:
            problems.append(Problem(entry.file, "has other bytes than were written (SHA-256 differs)"))
        else:
            try:
                with h5py.File(path, "r") as file:
                    schema.check(file, entry.file, entry.form)
            except (OSError, DatasetError) as error:
                problems.append(Problem(entry.file, f"cannot be read: {error}"))
    return manifest, problems


def rebuild_hint(manifest: Manifest) -> str:
    """The command that makes what is missing."""
    return f"run `{manifest.command}`" if manifest.command else "run the same `make rirs` again"
