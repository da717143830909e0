"""Several datasets under one folder, as one."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from soundspaces_sim.core.errors import DatasetError
from soundspaces_sim.dataset.format import collection_manifest
from soundspaces_sim.dataset.format.manifest import datasets_in
from soundspaces_sim.dataset.format.splits import SPLITS, read_splits, scenes_of_split
from soundspaces_sim.dataset.reader import RirDataset

if TYPE_CHECKING:
    from soundspaces_sim.rendering.ears import Ears


class RirCollection(Mapping[str, RirDataset]):
    """Datasets by their folder's name, in alphabetical order: a mapping. Pickles and opens as they do.

    `pairs`: how many responses there are in all. `manifest`: of a folder that `soundspaces-sim collection` made,
    which then says what belongs to it; else None.
    """

    def __init__(
        self,
        root: str | Path,
        rate: int | None = None,
        hrtf: str | Path | Ears | None = None,
        renderer: str | None = None,
        split: str | None = None,
    ) -> None:
        self.root = Path(root)
        self.manifest = None
        folders = datasets_in(self.root)
        if (self.root / collection_manifest.NAME).is_file():
            self.manifest = collection_manifest.read_collection(self.root)
            folders = sorted(self.root / s.scene for s in self.manifest.scenes)
        if not folders:
            raise DatasetError(
                f"no dataset at {self.root}, nor in a folder in it; make one with `make rirs`"
            )
        if split is not None:
            splits = read_splits(self.root / SPLITS, [folder.name for folder in folders])
            chosen = scenes_of_split(self.root, splits, split)
            folders = [folder for folder in folders if folder.name in chosen]
        self._scenes = {folder.name: RirDataset(folder, rate, hrtf, renderer) for folder in folders}
        self.pairs = sum(len(ds) for ds in self._scenes.values())

    def __repr__(self) -> str:
        names = list(self)
        shown = ", ".join(names[:6]) + (f" and {len(names) - 6} more" if len(names) > 6 else "")
        return f"RirCollection({str(self.root)!r}): {self.pairs:,} pairs in {len(names)} scenes: {shown}"

    def __getitem__(self, scene: str) -> RirDataset:
        return self._scenes[scene]

    def __iter__(self) -> Iterator[str]:
        return iter(self._scenes)

    def __len__(self) -> int:
        return len(self._scenes)

    def __enter__(self) -> RirCollection:
        return self

    def __exit__(self, *_: object) -> None:
        for ds in self._scenes.values():
            ds.close()

    def sample(self, count: int, seed: int = 0) -> list[tuple[str, int, int]]:
        """`count` random (scene, source, listener), every pair of every scene equally likely."""
        names = list(self)
        sizes = np.array([len(self[n]) for n in names])
        ends = np.cumsum(sizes)
        drawn = np.random.default_rng(seed).integers(0, self.pairs, count)
        out = []
        for row in drawn:
            k = int(np.searchsorted(ends, row, "right"))
            source, listener = divmod(int(row - (ends[k] - sizes[k])), len(self[names[k]].points))
            out.append((names[k], source, listener))
        return out


def open_datasets(
    root: str | Path,
    rate: int | None = None,
    hrtf: str | Path | Ears | None = None,
    renderer: str | None = None,
    split: str | None = None,
) -> RirCollection:
    """Open every dataset in the folders of `root`, as `open_dataset` does, or those of a `split` of its
    `splits.toml`. Raises `DatasetError` if there is none, `ConfigError` for an unknown split."""
    return RirCollection(root, rate, hrtf, renderer, split)
