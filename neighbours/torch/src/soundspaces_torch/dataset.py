"""Datasets as PyTorch wants them (extra ``torch``): map-style, any number of workers, fork or spawn."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from torch.utils.data import Dataset

from soundspaces_sim import ConfigError, Echogram, RirCollection, RirDataset
from soundspaces_sim.echogram import room_measures
from soundspaces_sim.parts import (
    MEASURES,
    TableEntry as Entry,
    as_pairs,
    check_pairs,
    of_neighbour,
    pairs_of_two,
    source_direction,
)
from soundspaces_torch import RandomMaterials, draw_furnished

Item = dict[str, Any]
_RENDERER = Entry("soundspaces_torch.renderer:Renderer", "responses on a device", "torch")
_STREAM = 1  # keeps draws of materials apart from those of headings


def pair_labels(
    ds: RirDataset, pairs: np.ndarray, names: Sequence[str] | None = None
) -> dict[str, np.ndarray]:
    """Labels of (k, 2) pairs: columns of the table (k,), and those per band under their common name, (k, bands).

    `names`: ``distance``, ``t30`` and so on; by default all but points and positions. Raises `ConfigError` if there
    is no such column.
    """
    table = ds.table(collocated=True)
    columns: dict[str, list[str]] = {}
    for column in table.dtype.names or ():
        name, _, band = column.rpartition("_")
        columns.setdefault(name if band.isdigit() else column, []).append(column)
    own = {"source", "listener", *(f"{end}_{axis}" for end in ("source", "listener") for axis in "xyz")}
    names = [n for n in columns if n not in own] if names is None else names
    unknown = [n for n in names if n not in columns]
    if unknown:
        raise ConfigError(f"labels: no '{unknown[0]}' in the table; there are {', '.join(columns)}")
    rows = table[pairs[:, 0] * len(ds.points) + pairs[:, 1]]  # every pair, by source and listener
    return {
        n: rows[n] if columns[n] == [n] else np.stack([rows[c] for c in columns[n]], axis=-1)
        for n in names
    }


class TorchRirDataset(Dataset[Item]):
    """Pairs of a dataset, or of several, with their labels.

    Items are dicts: ``rir`` (2, `samples`) or (9, `samples`) float32, cut or padded with zeros; ``source``,
    ``listener`` (3,) m; ``pair`` (2,) rows of points; ``scene``, its name; ``heading_deg``; ``azimuth_deg`` and
    ``elevation_deg`` of the source from a head with that heading (`labels.source_direction`; ambisonic responses
    are in world axes, as of a head that faces +X); and the labels: ``distance``, ``visible``, …, and per band
    ``t30``, ``drr``, ``late_error``, … (bands,), as `RirDataset.columns` explains them.

    `pairs`: of a dataset (k, 2) rows of points; of a collection k (scene, source, listener), as its `sample` gives
    them; by default all of two points, as in the table, and with `collocated` those of a point with itself.
    `samples`: by default the longest response. `labels`: names, by default all of the table.

    `headings_deg`: one is drawn each time that an item is read. With `seed` None PyTorch's generator draws it, so
    that it changes from epoch to epoch, and ``torch.manual_seed`` repeats a run with as many workers. With a number
    it is drawn from the seed, the epoch that `set_epoch` states, and the item alone, whatever the workers.

    `materials`: others in every item (`RandomMaterials`), drawn as headings are, of a dataset with counts of
    reflections. Items then have ``absorption``, (groups, bands) in the order of the dataset's `materials`, NaN
    where a scene has fewer groups than another; responses, measures and errors of energies are those of the draw,
    and standard errors of measures are left out.

    `device`: where responses are rendered, by a `Renderer` for each scene, which neighbours/torch has; ``rir`` lies
    there. Echograms are kept there, if they take at most `cache_mb` MB in all. A `DataLoader` without workers asks
    for whole batches, which are rendered at once; workers cannot use a device other than ``cpu``. None: by the
    NumPy reader, in workers too.

    Raises `ConfigError`, `PairIndexError`; `DatasetError` and `MaterialError` where `materials` cannot be drawn.
    """

    def __init__(
        self,
        dataset: RirDataset | RirCollection,
        pairs: Any = None,
        samples: int | None = None,
        kind: str = "binaural",
        headings_deg: Sequence[float] = (0.0, 90.0, 180.0, 270.0),
        seed: int | None = None,
        labels: Sequence[str] | None = None,
        materials: RandomMaterials | None = None,
        *,
        collocated: bool = False,
        device: str | torch.device | None = None,
        cache_mb: float = 1024.0,
    ) -> None:
        if kind not in ("binaural", "ambisonic"):
            raise ConfigError(f"kind: expected binaural or ambisonic, got {kind!r}")
        self.headings = tuple(float(h) for h in headings_deg)
        if not self.headings or not np.isfinite(self.headings).all():
            raise ConfigError(f"headings_deg: expected one or more finite numbers, got {headings_deg!r}")
        self.dataset, self.kind, self.seed = dataset, kind, seed
        self._scenes = dict(dataset) if isinstance(dataset, RirCollection) else {dataset.scene: dataset}
        self._names = list(self._scenes)
        self._scene, self.pairs = self._rows(pairs, collocated)
        self._check_alike()
        first = self._scenes[self._names[0]]
        longest = max(ds.manifest.duration for ds in self._scenes.values())
        self.samples = samples or int(np.ceil(longest * first.rate))
        self._labels = self._labels_of(labels)
        self.materials, self._groups = materials, 0
        if materials is not None:
            self._prepare_materials()
        self._renderers: dict[str, Any] | None = None
        if device is not None:
            make, share = of_neighbour("device", _RENDERER), cache_mb / len(self._scenes)
            self._renderers = {n: make(ds, device, cache_mb=share) for n, ds in self._scenes.items()}
        # In shared memory, so that a new epoch also reaches workers that stay from one to the next.
        self._epoch = torch.zeros((), dtype=torch.int64).share_memory_()

    def _check_alike(self) -> None:
        """Raise `ConfigError` unless all scenes have one rate and one set of bands, as batches need."""
        alike: dict[str, dict[str, object]] = {
            "rate, Hz": {n: ds.rate for n, ds in self._scenes.items()},
            "bands, Hz": {n: ds.manifest.config.simulation.bands for n, ds in self._scenes.items()},
        }
        for what, values in alike.items():
            first = self._names[0]
            for name, value in values.items():
                if value != values[first]:
                    raise ConfigError(
                        f"{what}: expected the same for all scenes, got {values[first]} for {first} and {value} "
                        f"for {name}; open them at one rate, or only scenes with the same bands"
                    )

    def _rows(self, pairs: Any, collocated: bool) -> tuple[np.ndarray, np.ndarray]:
        """Of every item the number of its scene (k,), and its pair (k, 2)."""
        if pairs is None:
            counts = [len(ds.points) for ds in self._scenes.values()]
            every = [
                np.indices((n, n)).reshape(2, -1).T if collocated else pairs_of_two(n) for n in counts
            ]
            return np.repeat(np.arange(len(every)), [len(p) for p in every]), np.concatenate(every)
        if not isinstance(self.dataset, RirCollection):
            rows = as_pairs(pairs)
            scene = np.zeros(len(rows), int)
        else:
            unknown = [p for p in pairs if len(p) != 3 or p[0] not in self._scenes]
            if unknown:
                raise ConfigError(
                    "pairs: expected (scene, source, listener) with a scene of "
                    f"{', '.join(self._names)}, got {unknown[0]!r}"
                )
            scene = np.array([self._names.index(p[0]) for p in pairs], int)
            rows = as_pairs([p[1:] for p in pairs])
        for k, ds in enumerate(self._scenes.values()):
            check_pairs(rows[scene == k], len(ds.points), str(ds.path))
        return scene, rows

    def _labels_of(self, names: Sequence[str] | None) -> dict[str, np.ndarray]:
        """Labels of all items, each (items, …)."""
        out: dict[str, np.ndarray] = {}
        if names is not None and not names:
            return out  # and no table is read
        for k, ds in enumerate(self._scenes.values()):
            here = self._scene == k
            for name, values in pair_labels(ds, self.pairs[here], names).items():
                whole = out.setdefault(name, np.zeros((len(here), *values.shape[1:]), values.dtype))
                whole[here] = values
        return out

    def _prepare_materials(self) -> None:
        """Read what is drawn from, so that what is wrong is told now; drop labels of the materials as simulated."""
        rng = np.random.default_rng(0)
        for ds in self._scenes.values():
            _, absorption = draw_furnished(ds.counted(0, 0), self.materials, rng)  # type: ignore[arg-type]  # there are some
            self._groups = max(self._groups, len(absorption))
        for name in MEASURES:
            self._labels.pop(f"{name}_error", None)

    def set_epoch(self, epoch: int) -> None:
        """Draw other headings from now on, those of this epoch (with a `seed`), in all workers."""
        self._epoch.fill_(epoch)

    def __len__(self) -> int:
        return len(self.pairs)

    def _heading(self, item: int) -> float:
        if self.kind == "ambisonic":
            return 0.0
        if self.seed is None:
            return self.headings[int(torch.randint(len(self.headings), ()))]
        rng = np.random.default_rng((self.seed, int(self._epoch), item))
        return self.headings[int(rng.integers(len(self.headings)))]

    def __getitem__(self, item: int) -> Item:
        if self._renderers is not None:
            return self.__getitems__([item])[0]
        ds, s, l = self._pair(item)
        heading, echogram, changed = self._draw(item)
        if echogram is not None:
            rir = ds.rendered(echogram, s, l, None if self.kind == "ambisonic" else heading)
        else:
            rir = ds.binaural(s, l, heading) if self.kind == "binaural" else ds.ambisonic(s, l)
        return self._item(item, torch.from_numpy(np.array(rir)), heading, changed)

    def __getitems__(self, items: Sequence[int]) -> list[Item]:
        """Several items, their responses rendered at once where there is a `device`."""
        if self._renderers is None:
            return [self[item] for item in items]
        drawn = [self._draw(item) for item in items]
        responses: list[Any] = [None] * len(items)
        scenes = self._scene[np.asarray(items)]
        for scene in np.unique(scenes):
            here = np.flatnonzero(scenes == scene)
            rows = self.pairs[np.asarray(items)[here]]
            renderer = self._renderers[self._names[scene]]
            _check_worker(renderer.device)
            turns = None if self.kind == "ambisonic" else np.array([drawn[k][0] for k in here])
            echograms = [e for k in here if (e := drawn[k][1]) is not None]
            if echograms:
                made = renderer.rendered(echograms, rows, turns)
            else:
                made = renderer.ambisonic(rows) if turns is None else renderer.binaural(rows, turns)
            for k, response in zip(here, made, strict=True):
                responses[k] = response
        return [
            self._item(item, response, heading, changed)
            for item, response, (heading, _, changed) in zip(items, responses, drawn, strict=True)
        ]

    def _pair(self, item: int) -> tuple[RirDataset, int, int]:
        s, l = (int(i) for i in self.pairs[item])
        return self._scenes[self._names[self._scene[item]]], s, l

    def _item(self, item: int, rir: torch.Tensor, heading: float, changed: Item) -> Item:
        ds, s, l = self._pair(item)
        name = self._names[self._scene[item]]
        fixed = rir.new_zeros(rir.shape[0], self.samples)
        count = min(self.samples, rir.shape[1])
        fixed[:, :count] = rir[:, :count]
        azimuth, elevation = source_direction(ds, s, l, heading)
        return {
            "rir": fixed,
            "source": torch.from_numpy(ds.points[s].astype(np.float32)),
            "listener": torch.from_numpy(ds.points[l].astype(np.float32)),
            "pair": torch.tensor([s, l]),
            "scene": name,
            "heading_deg": heading,
            "azimuth_deg": azimuth,
            "elevation_deg": elevation,
            **{name: torch.tensor(values[item]) for name, values in self._labels.items()},
            **changed,
        }

    def _draw(self, item: int) -> tuple[float, Echogram | None, Item]:
        """Of an item its heading; and with drawn materials its echogram, and what they change of its labels."""
        ds, s, l = self._pair(item)
        heading = self._heading(item)
        if self.materials is None:
            return heading, None, {}
        if self.seed is None:
            rng = np.random.default_rng(int(torch.randint(2**62, ())))
        else:
            rng = np.random.default_rng((self.seed, int(self._epoch), item, _STREAM))
        echogram, absorption = draw_furnished(ds.counted(s, l), self.materials, rng)
        measures, errors = room_measures(echogram), echogram.relative_error
        found = {
            **{name: getattr(measures, name) for name in MEASURES},
            "early_error": errors[0],
            "late_error": errors[1],
        }
        padded = np.full((self._groups, absorption.shape[1]), np.nan, np.float32)
        padded[: len(absorption)] = absorption
        changed = {
            name: torch.from_numpy(np.asarray(found[name], np.float32))
            for name in self._labels.keys() & found.keys()
        }
        return heading, echogram, {**changed, "absorption": torch.from_numpy(padded)}


def _check_worker(device: torch.device) -> None:
    """Raise `ConfigError` in a loader's worker, unless it renders on its processor."""
    if device.type != "cpu" and torch.utils.data.get_worker_info() is not None:
        raise ConfigError(
            f"device: a DataLoader's workers cannot render on {device}; give the loader num_workers=0, "
            "which renders "
            "whole batches at once"
        )
