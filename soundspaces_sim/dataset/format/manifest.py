"""The manifest of a dataset: which shards it consists of, and what made them.

`manifest.json` lies beside the shards. While a job runs its status is "building"; when every shard is
published it is rewritten with status "complete" and the size and SHA-256 of each shard and of the floor plan.

Its last line but one is its own SHA-256, of all its bytes with zeros in that place.
"""

from __future__ import annotations

import hashlib
import json
import math
import re
from collections.abc import Sequence
from itertools import islice
from pathlib import Path
from typing import Any

import msgspec

from soundspaces_sim.core.config import JobConfig
from soundspaces_sim.core.errors import DatasetError, SoundSpacesSimError
from soundspaces_sim.core.io.files import publish
from soundspaces_sim.core.io.untrusted import MOST_JSON, parse_json, read_text
from soundspaces_sim.core.limits import LONGEST
from soundspaces_sim.core.simulation_config import without_constants
from soundspaces_sim.dataset.format.schema import Form

NAME = "manifest.json"
FORMAT = "soundspaces_sim/dataset"
VERSION = 2
FARTHEST = 1e5  # m, of any coordinate
_HEAD = 4096  # characters, within which a manifest says what it is
_ZEROS = "0" * 64
_FILE_NAME = re.compile(r"[A-Za-z0-9_-][A-Za-z0-9_.-]{0,99}")
_SURROGATE = re.compile(r"\\u[dD][89a-fA-F]")
_SCENE_NAME = re.compile(r"[^/\\\x00-\x1f\x7f-\x9f]{1,200}")
_COMMAND = re.compile(
    r"(make|soundspaces-sim( -v| --verbose| --log-json)*) rirs( [^\x00-\x1f\x7f-\x9f;&|<>`$()]*)?"
)


class ShardEntry(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One shard: points `sources[0]` to `sources[1]` (exclusive) × the same of `listeners`.

    `key`: the shard's attribute of that name.
    """

    file: str
    form: Form = "echogram"
    sources: tuple[int, int]
    listeners: tuple[int, int]
    bytes: int = 0
    sha256: str = ""
    key: str = ""


class FileEntry(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A file beside the shards."""

    file: str
    bytes: int
    sha256: str


class Manifest(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Everything a reader must know before it opens a shard.

    `nodes`, `edges`, `components`: the navigation graph, as in `graph.WalkGraph`. `command`: what was typed
    to make the dataset, and rebuilds what is missing of it. `code_commit`: of the code that planned it, empty
    where none was known. `target`: for what machine the code was generated
    that made it, on which the last digits hang. `height`: of grid points above the floor, m; None where
    points were given.
    """

    format: str = FORMAT
    version: int = VERSION
    status: str
    scene: str
    scene_digest: str
    key: str
    code_version: str
    code_commit: str = ""
    config: JobConfig
    duration: float
    notes: tuple[str, ...]
    points: tuple[tuple[float, float, float], ...]
    command: str = ""
    nodes: tuple[int, ...] = ()
    edges: tuple[tuple[int, int], ...] = ()
    components: tuple[int, ...] = ()
    shards: tuple[ShardEntry, ...]
    files: tuple[FileEntry, ...] = ()
    target: str = ""
    height: float | None = None

    def __repr__(self) -> str:
        size = sum(e.bytes for e in self.shards)
        return (
            f"Manifest of '{self.scene}' ({self.status}): {len(self.points):,} points, {len(self.shards)} shards, "
            f"{size / 1e6:.1f} MB, {self.duration:g} s, made by version {self.code_version}\n"
            f"  {self.config!r}"
        )

    @property
    def code(self) -> str:
        """Version and, where it is known, commit of what made it."""
        return (
            f"{self.code_version}, commit {self.code_commit}" if self.code_commit else self.code_version
        )

    @property
    def entries(self) -> tuple[ShardEntry | FileEntry, ...]:
        """All files of the dataset but this one."""
        return (*self.shards, *self.files)

    @property
    def complete(self) -> bool:
        """Whether every shard is there; else a job is under way, or was interrupted."""
        return self.status == "complete"


def write_manifest(folder: Path, manifest: Manifest) -> None:
    """Publish `manifest` in `folder`."""
    content = {**msgspec.to_builtins(manifest), "version": VERSION, "sha256": _ZEROS}
    text = json.dumps(content, indent=1, ensure_ascii=False) + "\n"
    digest = hashlib.sha256(text.encode()).hexdigest()
    publish(folder / NAME, (text.removesuffix(_tail(_ZEROS)) + _tail(digest)).encode())


def _tail(digest: str) -> str:
    return f'"sha256": "{digest}"\n}}\n'


def is_dataset(folder: Path) -> bool:
    """Whether a folder holds a dataset, finished or not."""
    path = folder / NAME
    try:
        with open(path, encoding="utf-8") as file:
            return path.is_file() and f'"{FORMAT}"' in file.read(_HEAD)
    except (OSError, UnicodeDecodeError):
        return False


def datasets_in(root: Path) -> list[Path]:
    """Folders in `root` that hold a dataset, finished or not, by name."""
    return sorted(path.parent for path in root.glob(f"*/{NAME}"))


def read_manifest(folder: Path) -> Manifest:
    """The manifest in `folder`. Raises `DatasetError` if there is none or it is not usable."""
    path = folder / NAME
    if not path.exists() and not path.is_symlink():
        inside = len([*islice(folder.glob(f"*/{NAME}"), 1000)]) if folder.is_dir() else 0
        what = "make one with `make rirs SCENE=...`"
        if folder.is_file():
            what = "this is a file, and a dataset is a folder"
            if (folder.parent / NAME).is_file():
                what = f"this is a file of the dataset {folder.parent}: open that folder"
            raise DatasetError(f"no dataset at {folder}: {what}")
        if inside:
            what = f"{inside} of its folders are datasets: open one of these, or all with open_datasets"
        raise DatasetError(f"no dataset at {folder}: {NAME} is missing; {what}")
    text = read_text(path, DatasetError, "manifest", MOST_JSON, follow=False)
    raw: Any = parse_json(text, path, DatasetError, "manifest")
    version = raw.get("version") if isinstance(raw, dict) else None
    if not isinstance(raw, dict) or raw.get("format") != FORMAT or version != VERSION:
        raise DatasetError(
            f"{path}: not a manifest that this version reads (expected {FORMAT} version {VERSION})"
        )
    if _SURROGATE.search(text):
        raise DatasetError(f"{path}: text in this manifest is no text (it has escapes of surrogates)")
    digest = raw.pop("sha256", None)
    config = raw.get("config")
    if isinstance(config, dict) and "simulation" in config:
        raw["config"] = {**config, "simulation": without_constants(config["simulation"])}
    try:
        manifest = msgspec.convert(raw, Manifest)
    except (msgspec.ValidationError, ValueError, SoundSpacesSimError) as error:
        raise DatasetError(f"{path}: {error}") from error
    problem = _problem(manifest)
    if problem:
        raise DatasetError(f"{path}: {problem}")
    if not _is_whole(text, digest):
        raise DatasetError(
            f"{path}: this manifest is not as it was written (its SHA-256 differs); get the file again, or run "
            "the same `make rirs` again in another place"
        )
    return manifest


def _is_whole(text: str, digest: Any) -> bool:
    tail = _tail(str(digest))
    if not text.endswith(tail):
        return False
    return hashlib.sha256((text.removesuffix(tail) + _tail(_ZEROS)).encode()).hexdigest() == digest


def _problem(m: Manifest) -> str:
    """What makes a manifest unusable, in words; empty if nothing does."""
    count = len(m.points)
    if not _SCENE_NAME.fullmatch(m.scene) or m.scene in (".", ".."):
        return f"scene name {m.scene[:80]!r} is not the name of a folder"
    if not all(math.isfinite(x) and abs(x) <= FARTHEST for p in m.points for x in p):
        return f"points need finite coordinates, at most {FARTHEST:g} m"
    if not 0.0 <= m.duration <= LONGEST:
        return f"duration {m.duration} s is not 0 to {LONGEST:g} s"
    if m.height is not None and not 0.0 <= m.height <= FARTHEST:
        return f"height {m.height} m cannot be"
    if not all(0 <= n < count for n in (*m.nodes, *(n for edge in m.edges for n in edge))):
        return f"the navigation graph has nodes that are not points 0 to {count - 1}"
    if len(m.components) not in (0, count):
        return f"{len(m.components)} components of {count} points"
    for entry in m.entries:
        if not _FILE_NAME.fullmatch(entry.file):
            return f"{entry.file[:80]!r} is not a plain file name"
    for form in ("echogram", "waveform"):
        entries = [e for e in m.shards if e.form == form]
        if entries and not _covers(entries, count):
            return f"the {form} shards do not cover all pairs of {count} points, each once"
    if count and not m.shards:
        return "there are no shards"
    return ""


def _covers(entries: Sequence[ShardEntry], count: int) -> bool:
    """Whether the entries are a lattice of blocks that covers all pairs once."""
    rows, columns = sorted({e.sources for e in entries}), sorted({e.listeners for e in entries})
    for spans in (rows, columns):
        ends = [0, *(last for _, last in spans)]
        if [first for first, _ in spans] != ends[:-1] or ends[-1] != count or ends != sorted(set(ends)):
            return False
    pairs = {(e.sources, e.listeners) for e in entries}
    return len(pairs) == len(entries) == len(rows) * len(columns)


def rebuild_command(manifest: Manifest) -> str:
    """The manifest's command, if it is one that makes datasets and nothing else; it may be a stranger's."""
    return manifest.command if _COMMAND.fullmatch(manifest.command) else ""
