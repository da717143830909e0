"""`verify`: is a dataset on disk what its manifest says?"""

from __future__ import annotations

import os
from collections.abc import Container
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from soundspaces_sim.core.errors import DatasetError
from soundspaces_sim.core.io.files import file_sha256
from soundspaces_sim.dataset.format.echogram_shard import EchogramShard
from soundspaces_sim.dataset.format.floorplan import NAME as FLOORPLAN, read_floorplan
from soundspaces_sim.dataset.format.manifest import (
    NAME as MANIFEST,
    FileEntry,
    Manifest,
    ShardEntry,
    read_manifest,
    rebuild_command,
)
from soundspaces_sim.dataset.format.shard import FAILED
from soundspaces_sim.dataset.format.waveform_shard import WaveformShard


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
    points = np.array(manifest.points, float).reshape(-1, 3)
    problems = []
    for entry in manifest.entries:
        path = folder / entry.file
        what = _differs(path, entry, full)
        if not what:
            try:
                if isinstance(entry, ShardEntry):
                    shard = (EchogramShard if entry.form == "echogram" else WaveformShard)(path)
                    with closing(shard):
                        shard.check_identity(entry, points, manifest.config.simulation.bands)
                        what = failed_pairs(shard)
                elif entry.file == FLOORPLAN:
                    read_floorplan(folder)
            except DatasetError as error:
                what = f"cannot be read: {error}"
        if what:
            problems.append(Problem(entry.file, what))
    return manifest, problems


def not_compared(folder: str | Path) -> list[str]:
    """Files of a dataset's folder that its manifest does not name, so that nobody can say whether they are as they
    were written: the cards, which are for people to fill in, and what was put there."""
    folder = Path(folder)
    return unnamed(folder, {MANIFEST, *(e.file for e in read_manifest(folder).entries)})


def unnamed(folder: Path, names: Container[str]) -> list[str]:
    """Files in a folder and those in it, by their paths there, without those of these paths."""
    files = (Path(place) / name for place, _, inside in os.walk(folder) for name in inside)
    found = (file.relative_to(folder).as_posix() for file in files)
    return sorted(name for name in found if name not in names)


def failed_pairs(shard: EchogramShard | WaveformShard) -> str:
    """Which pairs have no energies, if there are such; versions before 0.2 marked them and went on."""
    failed = np.argwhere(shard.pairs["status"] == FAILED)
    if not len(failed):
        return ""
    s, l = failed[0]
    first = f"{shard.source_index[s]} to {shard.listener_index[l]}"
    return (
        f"energies of {len(failed)} of {shard.pairs['status'].size} pairs are not finite (first: {first}); "
        "simulate them anew with this version"
    )


def _differs(path: Path, entry: ShardEntry | FileEntry, full: bool) -> str:
    """In what a file differs from its entry; empty if in nothing that was looked at."""
    if path.is_symlink() or not path.is_file():
        return "is not a regular file in this folder" if os.path.lexists(path) else "is missing"
    try:
        if path.stat().st_size != entry.bytes:
            return f"has {path.stat().st_size} bytes, expected {entry.bytes}"
        if full and file_sha256(path) != entry.sha256:
            return "has other bytes than were written (SHA-256 differs)"
    except (OSError, DatasetError) as error:
        return f"cannot be read: {error}"
    return ""


def rebuild_hint(manifest: Manifest) -> str:
    """The command that makes what is missing."""
    command = rebuild_command(manifest)
    return f"run `{command}`" if command else "run the same `make rirs` again"
