"""Digests of what a study was made of, for its report."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Iterator
from pathlib import Path

from soundspaces_sim.parts import MANIFEST_NAME as MANIFEST, read_manifest, unpacked_episodes as unpacked


def data_lines(out: Path) -> list[str]:
    """A section that names the datasets and episodes in a study's folder by SHA-256: of the datasets that of all
    keys (each of scene, points, settings, seed and code), of episodes that of all that is in their files."""
    rows = [*_datasets(out), *_episodes(out)]
    if not rows:
        return []
    head = ["## Data", "", "| | | SHA-256 |", "|---|---|---|"]
    return [*head, *rows, ""]


def _datasets(out: Path) -> Iterator[str]:
    for folder in sorted(out.glob("data*")):
        if any(folder.glob(f"*/{MANIFEST}")):
            yield datasets_row(folder)


def datasets_row(folder: Path) -> str:
    """A row that names the datasets in a folder by SHA-256."""
    manifests = [read_manifest(path.parent) for path in sorted(folder.glob(f"*/{MANIFEST}"))]
    targets = " / ".join(sorted({m.target for m in manifests}))
    points = sum(len(m.points) for m in manifests)
    about = f"{len(manifests)} scenes, {points:,} points, on {targets or 'machines not recorded'}"
    digest = _digest(f"{m.scene} {m.key}\n".encode() for m in manifests)
    return f"| datasets `{folder.name}` | {about} | `{digest}` |"


def _episodes(out: Path) -> Iterator[str]:
    for folder in sorted(path.parent for path in out.glob("episodes/*/*/*/content")):
        files = sorted(folder.glob("content/*.json.gz"))
        digest = _digest(unpacked(path) for path in files)
        yield f"| episodes `{folder.name}` | {len(files)} files | `{digest}` |"


def _digest(parts: Iterable[bytes]) -> str:
    return hashlib.sha256(b"".join(parts)).hexdigest()
