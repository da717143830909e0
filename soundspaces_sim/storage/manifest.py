"""The manifest of a dataset: which shards it consists of, and what made them.

`manifest.json` lies beside the shards. While a job runs its status is "building"; when every shard is
published it is rewritten with status "complete" and the size and SHA-256 of each shard.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import msgspec

from soundspaces_sim.base.config import JobConfig
from soundspaces_sim.base.errors import DatasetError
from soundspaces_sim.base.files import publish
from soundspaces_sim.storage.schema import Form

NAME = "manifest.json"
FORMAT = "soundspaces_sim/dataset"
VERSION = 1


class ShardEntry(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One shard: points `sources[0]` to `sources[1]` (exclusive) × the same of `listeners`."""

    file: str
    form: Form = "echogram"
    sources: tuple[int, int]
    listeners: tuple[int, int]
    bytes: int = 0
    sha256: str = ""


class Manifest(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Everything a reader must know before it opens a shard.

    `nodes`, `edges`, `components`: the walking graph, as in `graph.WalkGraph`. `command`: what was typed
    to make the dataset, and rebuilds what is missing of it.
    """

    format: str = FORMAT
    version: int = VERSION
    status: str
    scene: str
    scene_digest: str
    key: str
    code_version: str
    config: JobConfig
    duration: float
    notes: tuple[str, ...]
    points: tuple[tuple[float, float, float], ...]
    command: str = ""
    nodes: tuple[int, ...] = ()
    edges: tuple[tuple[int, int], ...] = ()
    components: tuple[int, ...] = ()
    shards: tuple[ShardEntry, ...]

    def __repr__(self) -> str:
        size = sum(e.bytes for e in self.shards)
        return (
            f"Manifest of '{self.scene}' ({self.status}): {len(self.points):,} points, {len(self.shards)} shards, "
            f"{size / 1e6:.1f} MB, {self.duration:g} s, made by version {self.code_version}\n"
            f"  {self.config!r}"
        )

    @property
    def complete(self) -> bool:
        """Whether every shard is there; else a job is under way, or was interrupted."""
        return self.status == "complete"


def write_manifest(folder: Path, manifest: Manifest) -> None:
    """Publish `manifest` in `folder`."""
    text = json.dumps(msgspec.to_builtins(manifest), indent=1, ensure_ascii=False) + "\n"
    publish(folder / NAME, text.encode())


def read_manifest(folder: Path) -> Manifest:
    """The manifest in `folder`. Raises `DatasetError` if there is none or it is not usable."""
    path = folder / NAME
    try:
        raw: Any = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise DatasetError(
            f"no dataset at {folder}: {NAME} is missing; make one with `make rirs SCENE=...`"
        ) from None
    except (OSError, ValueError) as error:
        raise DatasetError(f"{path}: cannot read this manifest ({error})") from error
    if not isinstance(raw, dict) or raw.get("format") != FORMAT or raw.get("version") != VERSION:
        raise DatasetError(
            f"{path}: not a manifest that this version reads (expected {FORMAT} version {VERSION})"
        )
    try:
        manifest = msgspec.convert(raw, Manifest)
    except (msgspec.ValidationError, ValueError) as error:
        raise DatasetError(f"{path}: {error}") from error
    for entry in manifest.shards:
        if Path(entry.file).name != entry.file:
            raise DatasetError(f"{path}: shard '{entry.file}' is not a plain file name")
    return manifest
