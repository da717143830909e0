"""The manifest of a collection of datasets: `collection.json` in the folder that holds theirs.

It lists the datasets that are whole, with the SHA-256 of their manifests (which have those of their shards), the
files beside them, and the scenes that failed.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import msgspec

from soundspaces_sim.core.errors import DatasetError
from soundspaces_sim.core.io.files import file_sha256, publish
from soundspaces_sim.core.io.untrusted import read_json
from soundspaces_sim.dataset.format import manifest as of_dataset
from soundspaces_sim.dataset.format.verify import Problem, unnamed, verify_dataset

NAME = "collection.json"
FORMAT = "soundspaces_sim/collection"
VERSION = 1

_Folder = Annotated[str, msgspec.Meta(pattern=r"^[A-Za-z0-9_-][A-Za-z0-9_.-]{0,199}\Z")]
_File = Annotated[
    str,
    msgspec.Meta(
        pattern=r"^([A-Za-z0-9_-][A-Za-z0-9_.-]{0,99}/){0,6}[A-Za-z0-9_-][A-Za-z0-9_.-]{0,99}\Z"
    ),
]
_Count = Annotated[int, msgspec.Meta(ge=0)]


class CollectedScene(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A dataset: its folder, `points`, `bytes` of its files, and the SHA-256 of its `manifest.json`."""

    scene: _Folder
    points: _Count
    bytes: _Count
    sha256: str


class Failure(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A scene that could not be made, and why."""

    scene: str
    error: str


class BesideEntry(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A file beside the datasets."""

    file: _File
    bytes: _Count
    sha256: str


class CollectionManifest(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What a collection consists of. `files`: those beside the datasets, by their paths in the folder."""

    format: str = FORMAT
    version: int = VERSION
    licence: str = ""
    citation: str = ""
    command: str = ""
    code_version: str = ""
    scenes: tuple[CollectedScene, ...]
    failures: tuple[Failure, ...] = ()
    files: tuple[BesideEntry, ...] = ()

    @property
    def pairs(self) -> int:
        """Room impulse responses of all datasets."""
        return sum(s.points**2 for s in self.scenes)

    @property
    def bytes(self) -> int:
        """Of all datasets."""
        return sum(s.bytes for s in self.scenes)


def collected(folder: Path) -> CollectedScene:
    """The entry of a finished dataset. Raises `DatasetError`."""
    found = of_dataset.read_manifest(folder)
    if not found.complete:
        raise DatasetError(f"{folder}: this dataset is not finished")
    path = folder / of_dataset.NAME
    size = path.stat().st_size + sum(e.bytes for e in found.entries)
    return CollectedScene(
        scene=folder.name, points=len(found.points), bytes=size, sha256=file_sha256(path)
    )


def beside(root: Path, files: list[Path]) -> tuple[BesideEntry, ...]:
    """Entries of files of a collection, by name."""
    return tuple(
        BesideEntry(
            file=path.relative_to(root).as_posix(), bytes=path.stat().st_size, sha256=file_sha256(path)
        )
        for path in sorted(files)
    )


def write_collection(root: Path, manifest: CollectionManifest) -> Path:
    """Publish `collection.json`."""
    text = json.dumps(msgspec.to_builtins(manifest), indent=1, ensure_ascii=False) + "\n"
    publish(root / NAME, text.encode())
    return root / NAME


def read_collection(root: Path) -> CollectionManifest:
    """The manifest of a collection. Raises `DatasetError` if it is none."""
    path = root / NAME
    raw = read_json(path, DatasetError, "manifest of a collection", follow=False)
    if not isinstance(raw, dict) or raw.get("format") != FORMAT or raw.get("version") != VERSION:
        raise DatasetError(f"{path}: expected {FORMAT}, version {VERSION}")
    try:
        found = msgspec.convert(raw, CollectionManifest)
    except msgspec.ValidationError as error:
        raise DatasetError(f"{path}: {error}") from error
    names = [s.scene for s in found.scenes]
    if len(set(names)) != len(names):
        raise DatasetError(f"{path}: a scene is listed twice")
    return found


def verify_collection(root: str | Path, full: bool = False) -> tuple[CollectionManifest, list[Problem]]:
    """The manifest of a collection, and what is wrong with its datasets and the files beside them: missing,
    changed, or, of a dataset, what `verify_dataset` finds. `full` compares every byte. Raises `DatasetError`."""
    root = Path(root)
    found = read_collection(root)
    problems: list[Problem] = []
    for scene in found.scenes:
        folder = root / scene.scene
        path = folder / of_dataset.NAME
        if path.is_symlink() or not path.is_file():
            problems.append(Problem(f"{scene.scene}/{path.name}", "is missing"))
        elif file_sha256(path) != scene.sha256:
            problems.append(Problem(f"{scene.scene}/{path.name}", "has other bytes than were written"))
        else:
            _, of_scene = verify_dataset(folder, full)
            problems += [Problem(f"{scene.scene}/{p.file}", p.what) for p in of_scene]
    return found, problems + [p for entry in found.files if (p := _differs(root, entry)) is not None]


def not_compared(root: str | Path) -> list[str]:
    """Files of a collection's folder that neither its manifest nor those of its datasets name."""
    root = Path(root)
    found = read_collection(root)
    names = {NAME, *(entry.file for entry in found.files)}
    for scene in found.scenes:
        entries = of_dataset.read_manifest(root / scene.scene).entries
        names |= {f"{scene.scene}/{name}" for name in (of_dataset.NAME, *(e.file for e in entries))}
    return unnamed(root, names)


def _differs(root: Path, entry: BesideEntry) -> Problem | None:
    path = root / entry.file
    if path.is_symlink() or not path.is_file():
        return Problem(entry.file, "is missing")
    if path.stat().st_size != entry.bytes or file_sha256(path) != entry.sha256:
        return Problem(entry.file, "has other bytes than were written")
    return None
