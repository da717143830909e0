"""Writing shards, as bytes: a file in memory, checked against the schema before it goes anywhere.

A shard holds no clock times: the same content is the same bytes. Waveform shards are made from an echogram
shard, of some of its sources: what is stored is what a reader of the echograms would render.
"""

from __future__ import annotations

import io
import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from soundspaces_sim.core.errors import SimulationError
from soundspaces_sim.core.io.chunks import FILTERS, put_chunks, put_whole
from soundspaces_sim.core.io.hdf5 import create_hdf5, put_text, written
from soundspaces_sim.core.numerics.kernel import over_rows
from soundspaces_sim.dataset.format import schema
from soundspaces_sim.dataset.format.counts import count_fields
from soundspaces_sim.dataset.format.echogram_shard import EchogramShard
from soundspaces_sim.dataset.format.low import low_fields
from soundspaces_sim.dataset.format.schema import Form
from soundspaces_sim.dataset.format.shard import OK, SILENT
from soundspaces_sim.echogram.echogram import Echograms
from soundspaces_sim.echogram.measure_names import MEASURES
from soundspaces_sim.echogram.measures import echograms_measures

_STEP_DB = 0.4
_LOWEST = 1  # code of the least energy that is kept: 254 steps below the peak
_LEAST_SCALE = 1e-37
_STORAGE: dict[str, Any] = FILTERS  # checksums are of the data; HDF5 keeps one of all else


def _check_values(echoes: Echograms) -> None:
    """Raise `SimulationError` unless all that is to be stored can be."""
    pairwise = {
        "energy": np.isfinite(echoes.energy).all(axis=(2, 3, 4))
        & (echoes.energy[:, :, :, 0] >= 0.0).all(axis=(2, 3)),
        "direct_energy": (np.isfinite(echoes.direct_energy) & (echoes.direct_energy >= 0.0)).all(axis=2),
        "relative_error": (echoes.relative_error >= 0.0).all(axis=(2, 3)),
    }
    if echoes.low is not None:
        pairwise["low"] = np.isfinite(echoes.low).all(axis=(2, 3))
    early = np.isfinite(echoes.early.energy) & (echoes.early.energy >= 0.0)
    bad_early = np.searchsorted(echoes.early_start, np.flatnonzero(~early.all(axis=1)), "right") - 1
    pairwise["early_energy"] = ~np.isin(np.arange(len(echoes)), bad_early).reshape(echoes.shape)
    for name, ok in pairwise.items():
        for s, l in np.argwhere(~ok)[:1]:
            raise SimulationError(
                f"{name} of source {s} and listener {l} of this tile, at {echoes.sources[s]} and "
                f"{echoes.listeners[l]} m: expected finite values, energies of 0 or more; nothing was written "
                "for this tile; this is a defect of soundspaces_sim, please report the scene and the settings"
            )


def _pair_fields(echoes: Echograms, geodesic: np.ndarray | None = None) -> dict[str, np.ndarray]:
    """Datasets about each pair that every shard has; `geodesic` (S, L) m."""
    counts = np.diff(echoes.early_start).reshape(echoes.shape)
    energy = echoes.energy[:, :, :, 0]
    silent = (energy.max(axis=(2, 3)) <= 0.0) & (echoes.direct_energy.max(axis=2) <= 0.0) & (counts == 0)
    measures = echograms_measures(echoes)
    walked = np.full(echoes.shape, np.nan) if geodesic is None else geodesic
    return {
        "walls": np.minimum(echoes.walls, 65535).astype(np.uint16),
        "relative_error": _half(echoes.relative_error),
        "status": np.where(silent, SILENT, OK).astype(np.uint8),
        "geodesic": np.asarray(walked, np.float32),
        **{name: values.astype(np.float32) for name, values in measures.items()},
        "measure_error": _measure_error(echoes),
    }


def _measure_error(echoes: Echograms) -> np.ndarray:
    """(S, L, M, B) as it is stored; NaN where it is not known."""
    if echoes.measure_error is None:
        shape = *echoes.shape, len(MEASURES), len(echoes.bands) - 1
        return np.full(shape, np.nan, np.float16)
    return _half(echoes.measure_error)


def _half(errors: np.ndarray) -> np.ndarray:
    """Errors as they are stored; those that are not known, NaN or infinite, stay so."""
    return np.where(np.isinf(errors), np.inf, np.minimum(errors, 6e4)).astype(np.float16)


class _ShardWriter:
    """An HDF5 file in memory; `finish` checks it against the schema and returns its bytes."""

    def __init__(self, form: Form, attributes: Mapping[str, Any]) -> None:
        self._form: Form = form
        self._content = io.BytesIO()
        self.file = create_hdf5(self._content)
        for name, value in {**schema.fixed_attributes(form), **attributes}.items():
            if isinstance(value, str | bytes):
                put_text(self.file, name, value)
            else:
                self.file.attrs[name] = value

    def put(self, **values: np.ndarray) -> None:
        """Add datasets, each as one chunk."""
        put_whole(self.file, {name: value for name, value in values.items() if value.size})
        for name, value in values.items():
            if value.size == 0:
                dataset = self.file.create_dataset(
                    name, data=value, chunks=True, maxshape=value.shape, **_STORAGE
                )
                dataset.id.close()  # as `put_whole` does

    def put_pairs(self, **values: np.ndarray) -> None:
        """Add datasets with one chunk per pair, which is what a reader asks for."""
        for name, value in values.items():
            if value.size:
                put_chunks(self.file, name, value, 2)
            else:
                self.put(**{name: value})

    def finish(self) -> bytes:
        self.file.close()
        what = f"{self._form} shard"
        return written(self._content, what, lambda file: schema.check(file, what, self._form))


def _codes(energy: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of energies (S, L, bins, 9, B): the peak of each pair, codes of levels below it (S, L, bins, B), and ratios
    of moments to energy (S, L, bins, B, 8)."""
    sources, listeners, bins, channels, bands = energy.shape
    peak = np.empty((sources, listeners), energy.dtype)
    code = np.empty((sources, listeners, bins, bands), np.uint8)
    moments = np.empty((*code.shape, channels - 1), np.int8)

    def call(first: int, last: int) -> None:
        rows = slice(first, last)
        whole, others = energy[rows, :, :, 0], energy[rows, :, :, 1:]
        peak[rows] = whole.max(axis=(2, 3))
        safe = np.where(peak[rows] > 0.0, peak[rows], 1.0)[:, :, None, None]
        with np.errstate(divide="ignore"):
            level = 10.0 * np.log10(whole / safe)
        of_level = np.where(whole > 0.0, np.rint(255.0 + level / _STEP_DB), 0.0)
        code[rows] = np.where(of_level >= _LOWEST, of_level, 0.0)
        known = (code[rows] > 0)[:, :, :, None]
        ratio = np.divide(others, whole[:, :, :, None], out=np.zeros_like(others), where=known)
        moments[rows] = np.rint(np.clip(ratio, -1.0, 1.0) * 127.0).transpose(0, 1, 2, 4, 3)

    over_rows(call, sources, chunk=1)
    return peak, code, moments


def encode_echograms(
    echoes: Echograms,
    source_index: np.ndarray,
    listener_index: np.ndarray,
    attributes: Mapping[str, Any],
    geodesic: np.ndarray | None = None,
) -> bytes:
    """The shard's file. Energies to `_STEP_DB`, moment ratios to 1/127; `geodesic` (S, L) m.

    Raises `SimulationError` for energies that are not finite or negative.
    """
    _check_values(echoes)
    peak, code, moments = _codes(echoes.energy)
    names, counts, of_pairs = count_fields(echoes)
    edge, low, peaks = low_fields(echoes)
    own = {"energy_step_db": _STEP_DB, "group_names": names, "low_edge": edge}
    writer = _ShardWriter("echogram", {**own, **attributes})
    fields = {
        "source_index": source_index.astype(np.int64),
        "listener_index": listener_index.astype(np.int64),
        "source_position": echoes.sources,
        "listener_position": echoes.listeners,
        "band_edges": np.array(echoes.bands),
        "time_edges": echoes.time_edges,
        "energy_peak": peak.astype(np.float32),
        "direct_energy": echoes.direct_energy.astype(np.float32),
        "early_start": echoes.early_start.astype(np.int64),
        "early_delay": echoes.early.delay,
        "early_energy": echoes.early.energy.astype(np.float32),
        "early_direction": echoes.early.direction.astype(np.float32),
        "early_planes": echoes.early.planes.astype(np.int16),
        "early_kind": echoes.early.kind.astype(np.uint8),
        "early_edges": echoes.early.edges.astype(np.int32),
        "early_groups": echoes.early.groups.astype(np.int8),
        **_pair_fields(echoes, geodesic),
    }
    writer.put(**fields, **counts, low_peak=peaks)
    writer.put_pairs(**of_pairs, low=low, energy=code, moments=moments)
    return writer.finish()


def encode_waveforms(
    shard: EchogramShard,
    sources: slice,
    attributes: Mapping[str, Any],
    headings: tuple[float, ...],
    sample_format: str,
    render: Callable[[int], list[tuple[np.ndarray, np.ndarray]]],
) -> bytes:
    """The file of a waveform shard of an echogram shard's `sources`.

    `render(s)`: responses (9, n) and (H, 2, n) of the shard's source s at every listener, at
    attributes["rate"]; `headings` (H,) degrees; `sample_format`: int16 or float32.
    """
    writer = _ShardWriter("waveform", attributes)
    positions = shard.sources[sources]
    shape = len(positions), len(shard.listeners)
    distance = np.linalg.norm(positions[:, None] - shard.listeners[None], axis=2)
    onset = distance / float(attributes["speed_of_sound"])
    samples = math.ceil((shard.latest + 0.01) * attributes["rate"])
    writer.put(
        source_index=shard.read("source_index")[sources],
        source_position=positions,
        **{name: shard.read(name) for name in ("listener_index", "listener_position", "band_edges")},
        **{name: values[sources] for name, values in shard.pairs.items()},
        onset=onset.astype(np.float32),
        headings=np.array(headings, float),
    )

    kinds = {"ambisonic": (9, samples), "binaural": (len(headings), 2, samples)}
    scale = {name: np.ones(shape, np.float32) for name in kinds}
    length = np.zeros(shape, np.int32)
    stored = {}
    for name, tail in kinds.items():
        chunks: Any = (1, 1, *tail) if 0 not in tail else True
        stored[name] = writer.file.create_dataset(
            name, (*shape, *tail), sample_format, chunks=chunks, **_STORAGE
        )
    for i, s in enumerate(range(*sources.indices(len(shard.sources)))):
        for j, responses in enumerate(render(s)):
            length[i, j] = responses[0].shape[-1]
            for (name, tail), response in zip(kinds.items(), responses, strict=True):
                if response.size == 0:
                    continue
                padded = np.zeros(tail, np.float32)
                padded[..., : response.shape[-1]] = response
                if sample_format == "int16":
                    scale[name][i, j] = max(float(np.abs(padded).max()) / 32767.0, _LEAST_SCALE)
                    padded = np.rint(padded / scale[name][i, j])
                stored[name][i, j] = padded.astype(sample_format)
    for dataset in stored.values():
        dataset.id.close()  # as `put_whole` does
    writer.put(**{f"{name}_scale": factors for name, factors in scale.items()}, length=length)
    return writer.finish()
