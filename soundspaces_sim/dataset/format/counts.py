"""Counts of reflections as echogram shards hold them: in a byte each, finer where they are small."""

from __future__ import annotations

import json
from functools import cached_property

import numpy as np

from soundspaces_sim.core.errors import DatasetError
from soundspaces_sim.core.limits import LONGEST
from soundspaces_sim.dataset.format.schema import REBUILD
from soundspaces_sim.dataset.format.shard import Shard
from soundspaces_sim.echogram.echogram import Echograms
from soundspaces_sim.echogram.reflection_counts import (
    MOST_DISPERSION,
    MaterialGroups,
    ReflectionCounts,
    row_count,
)

_MOST_GROUPS = 12
_MOST = 255.0  # code of the largest mean
_OF_PAIRS = ("time", "peak", "mean", "dispersion", "anchored", "correlation")
_MOST_ANCHOR = 1e3  # of |z|
_MOST_CORRELATION = 127.0  # code of 1
_SQUARES = (np.arange(256) / _MOST) ** 2  # of a code
_Fields = dict[str, np.ndarray]


def count_fields(echoes: Echograms) -> tuple[str, _Fields, _Fields]:
    """Names of groups as JSON, datasets of all pairs, those with a chunk for each pair; empty without counts."""
    counts, shape, bands = echoes.counts, echoes.shape, len(echoes.bands) - 1
    if counts is None:
        none = np.empty((0, bands))
        groups = MaterialGroups((), np.empty(0), none, none, none)
        time, mean = np.empty((*shape, 0, bands)), np.empty((*shape, 0, 0, bands))
        counts = ReflectionCounts(groups, time, mean, mean, mean, mean)
    groups, mean = counts.groups, np.asarray(counts.mean, float)
    peak = mean.max(axis=2, initial=0.0).astype(np.float32)
    some = np.broadcast_to(peak[:, :, None] > 0.0, mean.shape)
    ratio = np.divide(mean, peak[:, :, None], out=np.zeros_like(mean), where=some)
    return (
        json.dumps(groups.names),
        {
            "group_share": np.asarray(groups.share, float),
            "group_absorption": np.asarray(groups.absorption, float),
            "group_transmission": np.asarray(groups.transmission, float),
            "group_anchor": np.asarray(groups.anchor, float),
        },
        {
            "count_time": np.asarray(counts.time, np.float32),
            "count_peak": peak,
            "count_dispersion": _coded(counts.dispersion / MOST_DISPERSION),
            "count_anchored": _coded(counts.anchored / MOST_DISPERSION),
            "count_correlation": np.rint(_MOST_CORRELATION * counts.correlation).astype(np.int8),
            "count_mean": _coded(ratio),
        },
    )


def _coded(share: np.ndarray) -> np.ndarray:
    """Numbers from 0 to 1 by their roots in a byte; greater ones as 1."""
    return np.rint(_MOST * np.sqrt(np.minimum(share, 1.0))).astype(np.uint8)


class StoredCounts:
    """The counts of an open shard: None of any pair if there are none. Raises `DatasetError`."""

    def __init__(self, shard: Shard) -> None:
        self._shard = shard
        names, bands = self._names(), len(shard.bands) - 1
        share, absorption = shard.read("group_share"), shard.read("group_absorption")
        transmission = shard.read("group_transmission")
        anchor = self._anchors(absorption, transmission)
        groups = MaterialGroups(tuple(names), share, absorption, transmission, anchor)
        for name, values in (("absorption", groups.absorption), ("transmission", groups.transmission)):
            shard.require((values >= 0.0) & (values <= 1.0), f"group_{name}", "shares of energy")
        left = groups.absorption + groups.transmission
        shard.require(left < 1.0, "group_absorption", "something that is reflected")
        shard.require((groups.share >= 0.0) & (groups.share <= 1.0), "group_share", "shares")
        fits = groups.absorption.shape == groups.anchor.shape == (len(names), bands)
        shard.require(fits, "group_absorption", f"those of {len(names)} groups")
        self.groups = groups if names else None

    def _names(self) -> list[str]:
        """The names of groups. Raises `DatasetError`."""
        try:
            names = json.loads(str(self._shard.attribute("group_names")))
        except (ValueError, RecursionError):
            names = None
        right = isinstance(names, list) and all(isinstance(n, str) for n in names)
        if not right or len(set(names)) != len(names) or len(names) > _MOST_GROUPS:
            raise DatasetError(
                f"{self._shard.where}: attribute 'group_names' is no list of at most {_MOST_GROUPS} names; "
                f"{REBUILD}"
            )
        return [str(name) for name in names]

    def _anchors(self, absorption: np.ndarray, transmission: np.ndarray) -> np.ndarray:
        """(M, b) z of groups: stored; in version 7 doubled absorption."""
        if self._shard.version < 8:
            reflected = 1.0 - absorption - transmission
            lost = np.divide(absorption, reflected, out=np.zeros(reflected.shape), where=reflected > 0.0)
            return np.asarray(-np.minimum(lost, 0.75))
        anchor = self._shard.read("group_anchor")
        self._shard.require(
            (anchor >= -1.0) & (anchor <= _MOST_ANCHOR), "group_anchor", "changes from -1 on"
        )
        return anchor

    @cached_property
    def _of_pairs(self) -> _Fields:
        """What all pairs have, as it is stored, read when the first pair's is wanted."""
        anchored = "doubled" if self._shard.version < 8 else "anchored"
        stored = {name: name for name in _OF_PAIRS} | {"anchored": anchored}
        found = {name: self._shard.read(f"count_{stored[name]}") for name in _OF_PAIRS}
        time, peak = found["time"], found["peak"]
        require = self._shard.require
        require((time >= 0.0) & (time <= LONGEST), "count_time", f"0 to {LONGEST:g} s")
        require(np.isfinite(peak) & (peak >= 0.0), "count_peak", "finite numbers, none negative")
        correlation = found["correlation"]
        require(correlation >= -_MOST_CORRELATION, "count_correlation", "codes from -127 on")
        fits = correlation.shape[3] == row_count(peak.shape[2])
        require(fits, "count_correlation", f"those of {peak.shape[2]} groups")
        return found

    def of_pair(self, s: int, l: int) -> ReflectionCounts | None:
        """Those of local source `s` and listener `l`."""
        if self.groups is None:
            return None
        time, peak, mean, *ratios, correlation = (self._of_pairs[name][s, l] for name in _OF_PAIRS)
        means = peak.astype(float) * _SQUARES[mean]
        ratio, anchored = (MOST_DISPERSION * _SQUARES[coded] for coded in ratios)
        of_pairs = means, ratio, anchored, correlation / _MOST_CORRELATION
        return ReflectionCounts(self.groups, time.astype(float), *of_pairs)
