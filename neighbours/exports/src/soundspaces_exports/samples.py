"""Samples of an export for training: a pair at a heading, or its ambisonic response, with the pair's labels."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from soundspaces_sim import RirDataset
from soundspaces_sim.parts import (
    SECOND_ORDER_CHANNELS as CHANNELS,
    response_samples_of as samples_of,
    source_direction,
)


class Sample(NamedTuple):
    """`heading`: degrees of a head, or None for ambisonics (ACN, SN3D)."""

    source: int
    listener: int
    heading: float | None

    def key(self, scene: str) -> str:
        """A name without dots or slashes."""
        form = "sn3d" if self.heading is None else f"{self.heading:g}"
        return f"{scene}_{self.source}_{self.listener}_{form}".replace(".", "p")


def samples_of_pairs(pairs: np.ndarray, headings: Sequence[float], ambisonics: bool) -> list[Sample]:
    """Samples of (k, 2) pairs."""
    forms: list[float | None] = [*headings, *([None] if ambisonics else [])]
    return [Sample(int(s), int(l), form) for s, l in pairs for form in forms]


def sample_bytes(ds: RirDataset, headings: Sequence[float], ambisonics: bool) -> float:
    """Of a sample's response in float32, on average over its forms."""
    channels = 2 * len(headings) + CHANNELS * ambisonics
    return 4.0 * samples_of(ds) * channels / max(len(headings) + ambisonics, 1)


def shuffled_files(ds: RirDataset, samples: Sequence[Sample], per_file: int) -> list[list[Sample]]:
    """The samples of each file, in random order drawn by the dataset's seed."""
    order = np.random.default_rng(ds.manifest.config.dataset.seed).permutation(len(samples))
    starts = range(0, len(samples), per_file)
    return [[samples[i] for i in order[k : k + per_file]] for k in starts]


def label_rows(ds: RirDataset) -> dict[tuple[int, int], Any]:
    """Rows of `RirDataset.table` by source and listener."""
    return {(int(r["source"]), int(r["listener"])): r for r in ds.table(collocated=True)}


def labelled(
    ds: RirDataset, samples: Sequence[Sample], rows: Mapping[tuple[int, int], Any]
) -> Iterator[tuple[Sample, np.ndarray, dict[str, Any]]]:
    """Each sample with its response (channels, n) float32 and its labels: what JSON has, None for no number.

    `rows`: of `label_rows`.
    """
    for sample in samples:
        s, l, heading = sample
        rir = ds.ambisonic(s, l) if heading is None else ds.binaural(s, l, heading)
        row = rows[s, l]
        azimuth, elevation = source_direction(ds, s, l, heading or 0.0)
        labels = {name: _plain(row[name]) for name in row.dtype.names}
        labels |= {"scene": ds.scene, "rate": ds.rate, "heading_deg": heading}
        labels |= {"azimuth_deg": _plain(azimuth), "elevation_deg": _plain(elevation)}
        yield sample, rir, labels


def _plain(value: Any) -> Any:
    """A number or truth value that JSON has; None for NaN and infinity."""
    plain = value.item() if isinstance(value, np.generic) else value
    return None if isinstance(plain, float) and not math.isfinite(plain) else plain
