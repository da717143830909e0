"""Responses of a dataset as tensors, rendered on a device in batches (extra ``torch``)."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias

import numpy as np
import scipy.fft
import torch
from numpy.typing import ArrayLike
from torch import Tensor

from soundspaces_sim import (
    ConfigError,
    Ears,
    Echogram,
    MaterialError,
    MicrophoneArray,
    RirDataset,
    refurnished,
)
from soundspaces_sim.parts import (
    HIGH_ORDER_WAVES as MANY_WAVES,
    NEAR_M,
    PLANE_WAVES as PLANE_WAVES,
    SECOND_ORDER_CHANNELS as CHANNELS,
    Materials,
    as_ears,
    as_pairs,
    check_degrees,
    check_order,
    check_pairs,
    check_rate,
    direction_grid as sphere,
    displaced,
    for_each_pair as for_each_pair,
    harmonics_sn3d,
    head_matrix,
    minimum_phase,
    near_field_gains,
    share_out,
    shared_energy,
    turned_lattice,
    waves_at_microphones as waves_at_microphones,
    waves_below as waves_below,
    without_arrivals,
)
from soundspaces_sim.rendering import load_hrtf
from soundspaces_torch import signals as signals
from soundspaces_torch.closure import log_ratios, nepers
from soundspaces_torch.echograms import KeptEchograms, as_batch
from soundspaces_torch.signals import Course, EchogramBatch

if TYPE_CHECKING:
    from soundspaces_sim import Directivity

    Emits: TypeAlias = Directivity | str | Sequence[Directivity | str | None] | None

_RENDERERS = ("default", "smooth", "paper", "direct")
_AT_ONCE = {"cpu": 8}  # responses: those of few stay in a processor's cache
_MANY = 256
_ALONE = threading.Lock()  # while PyTorch's number of threads, which is the whole process's, is one


class _Part(NamedTuple):
    """Some of a batch's pairs, whose responses have one length."""

    rows: np.ndarray  # (k,) of the batch
    batch: EchogramBatch
    course: Course
    seeds: np.ndarray  # (k,)
    echograms: Sequence[Echogram] | None  # if they were read one by one


class Renderer:
    """Responses of many pairs at once, as tensors on a device: those of `RirDataset`, the same noise included.

    `dataset`: as `open_dataset` opens it, with its rate, ears, renderer and materials. `device`: ``cpu``, ``cuda``,
    ``mps`` or a `torch.device`. All echograms are kept on the device if they take at most `cache_mb` MB; others are
    read from files by threads. `at_once`: responses that are made together, by default 8 on a processor and 256 on
    other devices.

    `pairs` in the methods below: (k, 2) rows of points. `source`: one directivity, or k. `materials`: as
    `open_dataset` takes them, or a tensor of absorption, (M, bands) or (k, M, bands) in the order of
    `dataset.materials`, to which gradients pass. Gradients pass to no angle, place or directivity.

    Raises `ConfigError`; the methods also `PairIndexError`, `DatasetError` and `MaterialError`.
    """

    def __init__(
        self,
        dataset: RirDataset,
        device: str | torch.device = "cpu",
        *,
        cache_mb: float = 1024.0,
        at_once: int | None = None,
    ) -> None:
        if not isinstance(dataset, RirDataset):
            raise ConfigError(
                f"dataset: expected a dataset as ss.open_dataset opens it, got {type(dataset).__name__}; of a "
                'collection give one of its scenes, as in Renderer(scenes["demo"])'
            )
        if at_once is not None and at_once < 1:
            raise ConfigError(f"at_once: expected 1 response or more, got {at_once}")
        if not cache_mb >= 0.0:
            raise ConfigError(f"cache_mb: expected 0 MB or more, got {cache_mb}")
        if dataset.renderer not in _RENDERERS:
            raise ConfigError(
                f"renderer: a device has {', '.join(_RENDERERS)}, the dataset is opened with {dataset.renderer!r}"
            )
        self.dataset, self.device = dataset, _checked(device)
        self._at_once = at_once or _AT_ONCE.get(self.device.type, _MANY)
        self._kept: KeptEchograms | None = None
        self._cache_mb = cache_mb

    def __repr__(self) -> str:
        return f"Renderer({str(self.dataset.path)!r}) on {self.device}"

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_kept": None}  # another process reads its own

    # Responses

    def ambisonic(
        self,
        pairs: ArrayLike,
        rate: int | None = None,
        *,
        source: Emits = None,
        order: int = 2,
        materials: Materials | Tensor | None = None,
        force: bool = False,
    ) -> Tensor:
        """(k, (order + 1)², n) `RirDataset.ambisonic` of k pairs, those that are shorter padded with zeros."""
        if order != 2:
            check_order(order)
        rows, rate = self._rows(pairs), self._rate(rate)
        if order == 2 and source is None and materials is None and self._waveforms(rate):
            return self._of_reader(rows, lambda s, l, _: self.dataset.ambisonic(s, l, rate))
        parts = self._parts(rows, rate, source, None, materials, force)
        make = self._field if order == 2 else lambda part: self._of_order(part, order)
        return self._joined(parts, len(rows), (order + 1) ** 2, make)

    def monaural(
        self,
        pairs: ArrayLike,
        rate: int | None = None,
        *,
        source: Emits = None,
        listener: Directivity | str | None = None,
        materials: Materials | Tensor | None = None,
        force: bool = False,
    ) -> Tensor:
        """(k, 1, n) `RirDataset.monaural` of k pairs."""
        if listener is None:
            found = self.ambisonic(pairs, rate, source=source, materials=materials, force=force)
            return found[:, :1]
        rows, rate = self._rows(pairs), self._rate(rate)
        parts = self._parts(rows, rate, source, listener, materials, force)
        return self._joined(parts, len(rows), 1, lambda part: self._field(part)[:, :1])

    def binaural(
        self,
        pairs: ArrayLike,
        headings_deg: ArrayLike = 0.0,
        rate: int | None = None,
        *,
        source: Emits = None,
        materials: Materials | Tensor | None = None,
        force: bool = False,
    ) -> Tensor:
        """(k, 2, n) `RirDataset.binaural` of k pairs. `headings_deg`: one, one for each pair, or (k, 3) of heading,
        pitch and roll."""
        rows, rate = self._rows(pairs), self._rate(rate)
        heads = _heads(headings_deg, len(rows))
        if source is None and materials is None and self._waveforms(rate):
            return self._of_reader(
                rows, lambda s, l, k: self.dataset.binaurals(s, l, heads[k : k + 1], rate)[0]
            )
        parts = self._parts(rows, rate, source, None, materials, force, heads)
        return self._joined(parts, len(rows), 2, lambda part: self._ears(part, heads[part.rows]))

    def microphones(
        self,
        pairs: ArrayLike,
        array: MicrophoneArray,
        rate: int | None = None,
        *,
        source: Emits = None,
        materials: Materials | Tensor | None = None,
        force: bool = False,
    ) -> Tensor:
        """(k, capsules, n) `RirDataset.microphones` of k pairs."""
        rows, rate = self._rows(pairs), self._rate(rate)
        parts = self._parts(rows, rate, source, None, materials, force)
        return self._joined(
            parts, len(rows), len(array.offsets), lambda part: self._at_array(part, array)
        )

    def rendered(
        self, echograms: Sequence[Echogram], pairs: ArrayLike, headings_deg: ArrayLike | None = None
    ) -> Tensor:
        """(k, 9, n) `RirDataset.rendered` of echograms of k pairs; (k, 2, n) at heads with headings."""
        rows = self._rows(pairs)
        if len(echograms) != len(rows):
            raise ConfigError(
                f"echograms: expected one for each of {len(rows)} pairs, got {len(echograms)}"
            )
        if headings_deg is None:
            parts = self._of_echograms(echograms, rows, self.dataset.rate)
            return self._joined(parts, len(rows), CHANNELS, self._field)
        heads = _heads(headings_deg, len(rows))
        parts = self._of_echograms(echograms, rows, self.dataset.rate, heads)
        return self._joined(parts, len(rows), 2, lambda part: self._ears(part, heads[part.rows]))

    # Targets, and dry sounds

    def until(
        self,
        responses: Tensor,
        pairs: ArrayLike,
        after_s: float = 0.05,
        rate: int | None = None,
        array: MicrophoneArray | None = None,
    ) -> Tensor:
        """Responses (k, c, n) up to `after_s` s after the direct sound's arrival, zeros from then on: targets of
        dereverberation, ``early`` by default and ``direct`` with .0025. With `array` those of each capsule."""
        rows, rate = self._rows(pairs), self._rate(rate)
        if not (math.isfinite(after_s) and after_s >= 0.0):
            raise ConfigError(f"after_s: expected 0 s or more, got {after_s}")
        if responses.ndim != 3 or len(responses) != len(rows):
            raise ConfigError(
                f"responses: expected ({len(rows)}, channels, n) as of these pairs, got {tuple(responses.shape)}"
            )
        offsets = np.zeros((1, 3)) if array is None else array.offsets
        points = self.dataset.points
        towards = points[rows[:, 0]][:, None] - (points[rows[:, 1]][:, None] + offsets)
        arrival = np.linalg.norm(towards, axis=2) / self.dataset.manifest.config.simulation.c
        last = np.floor((arrival + after_s) * rate + 1e-9).astype(np.int64)
        samples = torch.arange(responses.shape[-1], device=responses.device)
        keep = samples <= torch.from_numpy(last).to(responses.device)[..., None]
        return torch.where(keep, responses, 0.0)

    def convolve(self, audio: Tensor | ArrayLike, responses: Tensor) -> Tensor:
        """(k, c, m + n - 1): dry mono signals, (m,) or (k, m), through responses (k, c, n)."""
        dry = torch.as_tensor(audio, dtype=torch.float32, device=responses.device)
        if dry.ndim not in (1, 2) or dry.shape[-1] < 1 or (dry.ndim == 2 and len(dry) != len(responses)):
            raise ConfigError(
                f"audio: expected mono signals, (m,) or ({len(responses)}, m), got {tuple(dry.shape)}"
            )
        return signals.convolved(dry, responses)

    def render(
        self,
        audio: Tensor | ArrayLike,
        pairs: ArrayLike,
        headings_deg: ArrayLike = 0.0,
        *,
        source: Emits = None,
    ) -> Tensor:
        """(k, 2, m + n - 1): dry mono signals at the dataset's rate, (m,) or (k, m), as heard at the listeners."""
        return self.convolve(audio, self.binaural(pairs, headings_deg, source=source))

    # What is read

    def _rows(self, pairs: ArrayLike) -> np.ndarray:
        given = pairs.detach().cpu().numpy() if isinstance(pairs, Tensor) else pairs
        rows = as_pairs(given)
        check_pairs(rows, len(self.dataset.points), str(self.dataset.path))
        if len(rows) == 0:
            raise ConfigError("pairs: expected at least one")
        return rows

    def _rate(self, rate: int | None) -> int:
        return self.dataset.rate if rate is None else check_rate(rate)

    def _waveforms(self, rate: int) -> bool:
        return self.dataset.stored.has_waveforms(rate, self.dataset.renderer)

    def _of_reader(self, rows: np.ndarray, read: Callable[[int, int, int], np.ndarray]) -> Tensor:
        """Responses as they are stored."""
        found = [read(int(s), int(l), k) for k, (s, l) in enumerate(rows)]
        return signals.stacked([torch.from_numpy(np.array(r)).to(self.device) for r in found])

    def _parts(
        self,
        rows: np.ndarray,
        rate: int,
        source: Emits,
        listener: Directivity | str | None,
        materials: Materials | Tensor | None,
        force: bool,
        heads: np.ndarray | None = None,
    ) -> Iterator[_Part]:
        """The pairs, those of one length together, `at_once` at most."""
        emits = for_each_pair(source, len(rows))
        plain = listener is None and materials is None and all(e is None for e in emits)
        shifted = heads is not None and any(as_ears(self.dataset.hrtf).offset)
        if plain and not shifted and self.dataset.renderer != "direct" and self._keep():
            return self._kept_parts(rows, rate)
        if isinstance(materials, Tensor):
            if listener is not None or any(e is not None for e in emits):
                raise ConfigError(
                    "materials: a tensor of absorption goes with omnidirectional ends; give a mapping of names for "
                    "directive ones"
                )
            return self._absorbing_parts(rows, rate, materials, force, heads)
        ds = self.dataset

        def read(k: int) -> Echogram:
            s, l = (int(i) for i in rows[k])
            return ds.echogram(s, l, emits[k], listener, materials=materials, force=force)

        with ThreadPoolExecutor() as pool:
            echograms = list(pool.map(read, range(len(rows))))
        return self._of_echograms(echograms, rows, rate, heads)

    def _keep(self) -> bool:
        """Whether echograms are kept on the device; from the first time on they are, if they may be."""
        ds = self.dataset
        most = 1e6 * self._cache_mb
        if self._kept is None and ds.stored.plain_echograms and KeptEchograms.size(ds) <= most:
            self._kept = KeptEchograms(ds, self.device)
        return self._kept is not None

    def _course(self, time_edges: np.ndarray, rate: int, n: int) -> Course:
        simulation = self.dataset.manifest.config.simulation
        return Course(tuple(simulation.bands), time_edges, simulation.air, rate, n, self.device)

    def _seeds(self, rows: np.ndarray) -> np.ndarray:
        return signals.pair_seeds(self.dataset.manifest.config.dataset.seed, rows)

    def _chunks(self, lengths: np.ndarray, arrivals: np.ndarray) -> Iterator[tuple[int, np.ndarray]]:
        """(samples, pairs) that are rendered together, of responses' `lengths` (k,) and numbers of `arrivals`
        (k,): a part costs as many of the latter as its richest pair has."""
        most = self._at_once
        if self.device.type == "cpu":
            most = min(most, -(-len(lengths) // torch.get_num_threads()))
        for n in np.unique(lengths):
            alike = np.flatnonzero(lengths == n)
            if len(alike) > most:
                alike = alike[np.argsort(arrivals[alike], kind="stable")]
            for first in range(0, len(alike), most):
                yield int(n), alike[first : first + most]

    def _kept_parts(self, rows: np.ndarray, rate: int) -> Iterator[_Part]:
        kept = self._kept
        assert kept is not None
        at = rows[:, 0] * len(self.dataset.points) + rows[:, 1]
        lengths = _lengths(kept.kept.last[at], kept.time_edges, rate)
        for n, some in self._chunks(lengths, kept.kept.arrival_count[at]):
            batch, _ = kept.batch(rows[some])
            yield _Part(
                some, batch, self._course(kept.time_edges, rate, n), self._seeds(rows[some]), None
            )

    def _of_echograms(
        self,
        echograms: Sequence[Echogram],
        rows: np.ndarray,
        rate: int,
        heads: np.ndarray | None = None,
    ) -> Iterator[_Part]:
        if self.dataset.renderer == "direct":
            echograms = [_direct_alone(e) for e in echograms]
        if heads is not None and any(offset := as_ears(self.dataset.hrtf).offset):
            echograms = [self._moved(e, head, offset) for e, head in zip(echograms, heads, strict=True)]
        ends = np.array([max([0.0, *(a.delay + 0.01 for a in e.arrivals)]) for e in echograms])
        lengths = _lengths(ends, echograms[0].time_edges, rate)
        for n, some in self._chunks(lengths, np.array([len(e.early) for e in echograms])):
            chosen = [echograms[k] for k in some]
            batch, _ = as_batch(chosen, self.device)
            course = self._course(chosen[0].time_edges, rate, n)
            yield _Part(some, batch, course, self._seeds(rows[some]), chosen)

    def _moved(self, echogram: Echogram, head: np.ndarray, offset: tuple[float, ...]) -> Echogram:
        """As `ears.ear_rirs` moves a head off its point."""
        shift = head_matrix(float(head[0]), 0.0, 0.0) @ np.asarray(offset, float)
        c = self.dataset.manifest.config.simulation.c
        moved, *_ = displaced(echogram, np.zeros(3), shift, -echogram.early.direction, c)
        return moved

    def _absorbing_parts(
        self,
        rows: np.ndarray,
        rate: int,
        absorption: Tensor,
        force: bool,
        heads: np.ndarray | None,
    ) -> Iterator[_Part]:
        """Echograms with `absorption`, to which gradients pass."""
        plain = [self.dataset.counted(int(s), int(l)) for s, l in rows]
        groups = plain[0].counts.groups  # type: ignore[union-attr]  # `counted` has them
        shape = (len(groups.names), len(plain[0].bands) - 1)
        if absorption.ndim not in (2, 3) or tuple(absorption.shape[-2:]) != shape:
            raise MaterialError(
                f"materials: expected absorption of shape {shape} or ({len(rows)}, {shape[0]}, {shape[1]}), for "
                f"{', '.join(groups.names)}, got {tuple(absorption.shape)}"
            )
        whole = absorption.to(self.device).expand(len(rows), *shape)
        most = torch.as_tensor(1.0 - groups.transmission).to(whole)
        if not bool(((whole >= 0.0) & (whole < most)).all()):
            raise MaterialError(
                "materials: absorption must lie from 0 to below what a material does not transmit, got "
                f"{float(whole.min()):.4g} to {float(whole.max()):.4g}"
            )
        if not force:
            for k, echogram in enumerate(plain):
                what = f"{self.dataset.path}, pair {tuple(rows[k].tolist())}"
                refurnished(echogram, whole[k].detach().double().cpu().numpy(), what=what)
        double = torch.float32 if self.device.type == "mps" else torch.float64
        x = log_ratios(groups, whole.to(double))
        for part in self._of_echograms([replace(e, low=None) for e in plain], rows, rate, heads):
            assert part.echograms is not None
            own = x[torch.from_numpy(part.rows).to(self.device)]
            change = torch.exp(nepers([plain[k] for k in part.rows], own)).float()
            met = np.full((*part.batch.delay.shape, 3), -1)
            for k, echogram in enumerate(part.echograms):
                met[k, 1 : 1 + len(echogram.early)] = echogram.early.groups
            group = torch.from_numpy(met).to(self.device)
            which = torch.arange(len(own), device=self.device)[:, None, None]
            steps = torch.where((group >= 0)[..., None], own[which, group.clamp(min=0)], 0.0).sum(2)
            batch = part.batch._replace(
                energy=part.batch.energy * change[:, :, None],
                arrivals=part.batch.arrivals * torch.exp(steps).float(),
            )
            yield part._replace(batch=batch)

    # What is made of it

    def _joined(
        self, parts: Iterator[_Part], count: int, channels: int, make: Callable[[_Part], Tensor]
    ) -> Tensor:
        """(count, channels, n) what is made of all parts, shorter responses with zeros behind them."""
        every = list(parts)
        if self.device.type == "cpu" and not any(part.batch.energy.requires_grad for part in every):
            return self._joined_by_threads(every, count, channels, make)
        made = [(part.rows, make(part)) for part in every]
        if len(made) == 1:  # all at once, in order
            return made[0][1]
        if len({r.shape[-1] for _, r in made}) == 1:
            order = np.argsort(np.concatenate([rows for rows, _ in made]), kind="stable")
            whole = torch.cat([r for _, r in made])
            if (order == np.arange(count)).all():
                return whole
            return whole[torch.from_numpy(order).to(whole.device)]
        found: list[Any] = [None] * count
        for rows, response in made:
            for k, each in zip(rows, response, strict=True):
                found[k] = each
        return signals.stacked(found)

    def _joined_by_threads(
        self, parts: Sequence[_Part], count: int, channels: int, make: Callable[[_Part], Tensor]
    ) -> Tensor:
        """On a processor: as many parts at a time as PyTorch has threads, each in one. Threads that share every
        small operation wait for each other more than they work. This thread is one of them, and does it all where
        PyTorch has one, as in a loader's worker: MKL keeps memory for each thread that it has seen, and in a forked
        process it looked for that of a new one without end."""
        out = torch.empty(count, channels, max(part.course.n for part in parts))

        def one(k: int) -> None:
            with torch.no_grad():
                part = parts[k]
                response, rows = make(part), torch.from_numpy(part.rows)
                out[rows, :, : response.shape[-1]] = response
                out[rows, :, response.shape[-1] :] = 0.0

        with _ALONE:
            threads = torch.get_num_threads()
            torch.set_num_threads(1)
            try:
                share_out(one, range(len(parts)), threads)
            finally:
                torch.set_num_threads(threads)
        return out

    def _reverberation(self, part: _Part) -> Tensor:
        kind, batch, course = self.dataset.renderer, part.batch, part.course
        if kind == "direct":
            shape = len(batch.energy), CHANNELS, course.n
            return torch.zeros(shape, device=self.device)
        if kind == "paper":
            return signals.paper_reverberation(batch.energy, course, part.seeds)
        energy = signals.without_air(batch.energy, course)
        if kind == "smooth":
            if energy.requires_grad:
                raise ConfigError(
                    "renderer: no gradients pass through 'smooth'; open the dataset with renderer=\"default\""
                )
            steps = signals.step_energies(energy.cpu().numpy(), course)
            energy = course.tensor(np.ascontiguousarray(steps))
        return signals.reverberation(energy, course, part.seeds, kind)

    def _field(self, part: _Part) -> Tensor:
        """(k, 9, n) ambisonic responses."""
        return self._with_arrivals(self._reverberation(part), part)

    def _of_order(self, part: _Part, order: int) -> Tensor:
        def weights(direction: np.ndarray) -> np.ndarray:
            return harmonics_sn3d(direction, order).T

        offsets = np.zeros(((order + 1) ** 2, 3))
        return self._with_arrivals(self._plane_waves(part, MANY_WAVES, offsets, weights, 1.0), part)

    def _with_arrivals(self, reverberation: Tensor, part: _Part) -> Tensor:
        """`ambisonics.with_arrivals`."""
        channels, course = reverberation.shape[1], part.course
        return self._combined(
            reverberation,
            part,
            lambda onto: signals.with_arrivals(part.batch, course, onto),
            lambda low: waves_below(low, (channels, course.n), course.rate),
        )

    def _combined(
        self,
        reverberation: Tensor,
        part: _Part,
        arriving: Callable[[Tensor], Tensor],
        below: Callable[[Any], np.ndarray],
    ) -> Tensor:
        """`low_band.combined` of a reverberation, which is used up, with what is `arriving` put onto it; without
        waves, the sum."""
        lows = [None if e.low is None else e.low for e in part.echograms or ()]
        low = next((each for each in lows if each is not None), None)
        if low is None:
            return arriving(reverberation)
        found = np.stack([below(each) for each in lows])
        discrete = arriving(torch.zeros_like(reverberation))
        high = signals.above(reverberation, low.edge, part.course, of_arrivals=False)
        high = high + signals.above(discrete, low.edge, part.course, of_arrivals=True)
        return high + torch.from_numpy(found).to(self.device)

    def _plane_waves(
        self,
        part: _Part,
        count: int,
        offsets: np.ndarray,
        weights: Callable[[np.ndarray], np.ndarray],
        speed_of_sound: float,
    ) -> Tensor:
        """The reverberation as `waves.WaveField` has it."""
        energy = signals.without_air(part.batch.energy, part.course)
        plain = energy.detach().cpu().numpy().astype(float)
        directions, shares = [], []
        for seed, bands in zip(part.seeds, plain, strict=True):
            direction = turned_lattice(int(seed), count)
            of_bands = np.stack([shared_energy(np.ascontiguousarray(b.T), direction) for b in bands])
            whole = bands[:, 0, :, None]
            shares.append(np.divide(of_bands, whole, out=np.zeros_like(of_bands), where=whole > 0.0))
            directions.append(direction)
        found = signals.WaveShares(
            np.stack(directions), part.course.tensor(np.stack(shares).astype(np.float32))
        )
        return signals.plane_waves(
            energy[:, :, 0], part.course, found, part.seeds, offsets,
            lambda i: weights(directions[i]), speed_of_sound,
        )  # fmt: skip

    def _at_array(self, part: _Part, array: MicrophoneArray) -> Tensor:
        """`microphones.array_rir`."""
        bands, c = part.course.bands, self.dataset.manifest.config.simulation.c

        def weights(direction: np.ndarray) -> np.ndarray:
            return np.sqrt(array.energy_gains(direction, bands)).transpose(0, 2, 1)

        out = self._plane_waves(part, PLANE_WAVES, array.offsets, weights, c)
        batch = part.batch
        length = batch.delay.cpu().numpy() / signals.SECOND * c
        images = batch.direction.cpu().numpy().astype(float) * length[..., None]
        heard = (batch.arrivals.amax(-1, keepdim=True) > 0.0).float()
        found = []
        for k, offset in enumerate(array.offsets):
            towards = images - offset
            own = np.linalg.norm(towards, axis=2)
            near = np.where(length > 0.0, length / np.maximum(own, 1e-3), 1.0)
            gain = array.energy_gains(towards.reshape(-1, 3), bands)[k].reshape(*own.shape, -1)
            factor = part.course.tensor((gain * near[..., None] ** 2).astype(np.float32))
            delay = torch.from_numpy(signals.fixed(own / c)).to(self.device)
            found.append(signals.arrival_filters(batch.arrivals * factor, delay, part.course))

        def arriving(onto: Tensor) -> Tensor:
            rows = [signals.placed(*each, heard, onto[:, k : k + 1]) for k, each in enumerate(found)]
            return torch.cat(rows, 1)

        amplitudes = list(np.sqrt(array.energy_gains(sphere()[0], bands)[:, :, 0]))
        return self._combined(
            out,
            part,
            arriving,
            lambda low: waves_at_microphones(
                low, array.offsets, amplitudes, part.course.n, part.course.rate, c
            ),
        )

    def _ears(self, part: _Part, heads: np.ndarray) -> Tensor:
        """(k, 2, n) as `ears.ear_rirs` makes them, of heads (k, 3)."""
        ears = as_ears(self.dataset.hrtf)
        c = self.dataset.manifest.config.simulation.c
        batch = part.batch
        near = np.zeros(len(heads), bool)
        if ears.near_field:
            distance = batch.delay[:, 0].cpu().numpy() / signals.SECOND * c
            heard = (batch.arrivals[:, 0].amax(-1) > 0.0).cpu().numpy()
            near = heard & (distance > 0.0) & (distance < NEAR_M)
        if not near.any():
            return self._decoded(self._field(part), heads, part.course.rate, ears)
        which = torch.from_numpy(near).to(self.device)
        direct = batch.arrivals * (torch.arange(batch.delay.shape[1], device=self.device) == 0)[:, None]
        apart = torch.where(which[:, None, None], batch.arrivals - direct, batch.arrivals)
        out = self._decoded(
            self._field(part._replace(batch=batch._replace(arrivals=apart))),
            heads,
            part.course.rate,
            ears,
        )
        nothing = torch.zeros(len(heads), CHANNELS, part.course.n, device=self.device)
        alone = signals.with_arrivals(batch._replace(arrivals=direct), part.course, nothing)[which]
        low = None if part.echograms is None else part.echograms[0].low
        if low is not None:  # waves are in the field, the direct sound's as well
            alone = signals.above(alone, low.edge, part.course, of_arrivals=True)
        of_near = self._decoded(alone, heads[near], part.course.rate, ears)
        own = [
            head_matrix(*head).T @ towards
            for head, towards in zip(heads[near], batch.direction[which, 0].cpu().numpy(), strict=True)
        ]
        spectra, size = _near_spectra(own, distance[near], ears, part.course)
        made = torch.fft.irfft(torch.fft.rfft(of_near, size) * spectra, size)[..., : part.course.n]
        return out.index_add(0, torch.nonzero(which)[:, 0], made)

    def _decoded(self, field: Tensor, heads: np.ndarray, rate: int, ears: Ears) -> Tensor:
        return signals.decoded(field, heads, rate, ears.hrtf, ears.decoder, ears.equalisation)


def _near_spectra(
    own: Sequence[np.ndarray], distance: np.ndarray, ears: Ears, course: Course
) -> tuple[Tensor, int]:
    """((k, 2, f) what near sources lack at either ear, samples of the transform); see `ears`."""
    size = int(scipy.fft.next_fast_len(2 * course.n, real=True))
    size += size % 2
    frequency = np.maximum(np.fft.rfftfreq(size, 1.0 / course.rate), 1e-9)
    coarse = np.geomspace(20.0, 0.5 * course.rate, 200)
    reference = load_hrtf(ears.hrtf).distance
    found = []
    for direction, away in zip(own, distance, strict=True):
        both = near_field_gains(coarse, float(away), reference, direction)
        logs = [np.interp(np.log(frequency), np.log(coarse), np.log(gain)) for gain in both]
        found.append([np.exp(minimum_phase(log)) for log in logs])
    return course.tensor(np.array(found, np.complex64)), size


def _direct_alone(echogram: Echogram) -> Echogram:
    silent = replace(without_arrivals(echogram), energy=np.zeros_like(echogram.energy))
    return replace(silent, direct=echogram.direct, low=None)


def _lengths(ends: np.ndarray, time_edges: np.ndarray, rate: int) -> np.ndarray:
    """(k,) samples of responses whose last arrivals end at (k,) s: `ambisonics.response_length`."""
    return np.ceil(np.maximum(ends, float(time_edges[-1])) * rate).astype(np.int64)


def _heads(headings_deg: ArrayLike, count: int) -> np.ndarray:
    """(count, 3) heading, pitch and roll. Raises `ConfigError`."""
    given = headings_deg.detach().cpu().numpy() if isinstance(headings_deg, Tensor) else headings_deg
    turns = check_degrees(given, "headings_deg")
    if turns.shape in ((), (1,), (count,)):
        return np.stack([np.broadcast_to(turns, count), np.zeros(count), np.zeros(count)], axis=1)
    if turns.shape == (count, 3):
        return turns
    raise ConfigError(
        f"headings_deg: expected one, {count} of them, or ({count}, 3) of heading, pitch and roll, got "
        f"{turns.shape}"
    )


def _checked(device: str | torch.device) -> torch.device:
    """A device that is there. Raises `ConfigError`."""
    try:
        found = torch.device(device)
        torch.zeros(1, device=found)
    except (RuntimeError, AssertionError, ValueError, TypeError) as error:
        reason = (str(error).splitlines() or ["?"])[0]
        raise ConfigError(f"device: {device!r} is not to be had here ({reason})") from None
    if found.type == "meta":
        raise ConfigError("device: expected one that holds numbers, got 'meta'")
    return found
