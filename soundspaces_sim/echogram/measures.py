"""Room measures after ISO 3382-1:2009, from energy decays.

Conventions: energies per time bin, last axis time; times in s, levels in dB. The onset (the direct
sound's time) starts the early windows. A measure whose decay range is too short is NaN, and
`RoomMeasures.reasons` gives the reason.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from soundspaces_sim.core.errors import ConfigError
from soundspaces_sim.core.numerics.bands import DEFAULT_BANDS
from soundspaces_sim.core.numerics.kernel import over_rows
from soundspaces_sim.echogram.echogram import Echogram, Echograms
from soundspaces_sim.echogram.filters import band_windows
from soundspaces_sim.echogram.measure_errors import DIRECT_S, ONSET
from soundspaces_sim.echogram.measure_names import MEASURES

_HEADROOM_DB = 10.0  # the decay must reach this far below the evaluated range (ISO 3382-1, 5.3.3)
_SLOWEST = 0.9  # of what a cut response is taken to lose in a tenth of its length
BIN_S = 0.001
_AT_ONCE = 2**22  # energies of listeners that a thread works at
LARGEST_ERROR = 0.2  # relative, of a reverberation time that is told
RANGES = (("T20", -5.0, -25.0), ("T30", -5.0, -35.0), ("EDT", 0.0, -10.0))
_ONSET_DB = -20.0  # of the peak: where a response starts (ISO 3382-1, annex A.3.4)


@dataclass(frozen=True)
class RoomMeasures:
    """Each (bands,), except `reasons`: what is NaN and why."""

    t20: np.ndarray
    t30: np.ndarray
    edt: np.ndarray
    c50: np.ndarray
    c80: np.ndarray
    d50: np.ndarray
    ts: np.ndarray
    drr: np.ndarray
    reasons: tuple[str, ...]


def decay_curve(energy: np.ndarray) -> np.ndarray:
    """(…, n) backward-integrated energy in dB re the total (Schroeder 1965), at each bin's start."""
    remaining = np.cumsum(energy[..., ::-1], axis=-1)[..., ::-1]
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(10.0 * np.log10(remaining / remaining[..., :1]))


def reverberation_times(
    energy: np.ndarray, bin_s: float, upper_db: float, lower_db: float
) -> tuple[np.ndarray, np.ndarray]:
    """(…) times for 60 dB of energies (…, n), none below 0, from a line through the decay curve between two levels.

    EDT: (0, -10); T20: (-5, -25); T30: (-5, -35). Also returns the level (…) that the decay reaches, dB;
    a time is NaN unless that lies `_HEADROOM_DB` below `lower_db`. A response that was cut reaches no further than
    what was cut off: its curve would dive at the end, as if the room had gone silent.
    """
    curve, reached = _curve_and_depth(energy)
    return _fitted(curve, _sums(curve), reached, bin_s, upper_db, lower_db), reached


def _curve_and_depth(energy: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(…, n) decay curves of energies, and the level (…) that each reaches, dB."""
    curve = decay_curve(energy)
    reached = np.where(np.isfinite(curve), curve, 0.0).min(axis=-1)
    return curve, np.maximum(reached, _cut_off(energy))


def _sums(curve: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(…, n + 1) sums of levels (…, n) before each bin, and of the same times the number of their bins."""
    level = np.where(np.isfinite(curve), curve, 0.0)
    sums = np.zeros((2, *curve.shape[:-1], curve.shape[-1] + 1))
    np.cumsum(level, axis=-1, out=sums[0, ..., 1:])
    level *= np.arange(curve.shape[-1])
    np.cumsum(level, axis=-1, out=sums[1, ..., 1:])
    return sums[0], sums[1]


def _fitted(
    curve: np.ndarray,
    sums: tuple[np.ndarray, np.ndarray],
    reached: np.ndarray,
    bin_s: float,
    upper_db: float,
    lower_db: float,
) -> np.ndarray:
    """`reverberation_times` of curves that reach so far, with their `_sums`: a straight line through the bins
    from `first` up to, not including, `last`, as curves only fall."""
    first, last = (curve > upper_db).sum(axis=-1), (curve >= lower_db).sum(axis=-1)
    ends = np.stack([first, last], axis=-1)
    of_level, of_both = (np.diff(np.take_along_axis(s, ends, axis=-1))[..., 0] for s in sums)
    k, middle = (last - first).astype(float), 0.5 * (first + last - 1.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        slope = 12.0 * (of_both - middle * of_level) / (k * (k * k - 1.0) * bin_s)
        good = (reached <= lower_db - _HEADROOM_DB) & (k >= 3) & (slope < 0.0)
        return np.where(good, -60.0 / slope, np.nan)


def _cut_off(energy: np.ndarray) -> np.ndarray:
    """(…) dB re the total: energy after the end of (…, n), if it goes on from the last tenth as it fell to it."""
    part = energy.shape[-1] // 10
    if part < 1:
        return np.full(energy.shape[:-1], -np.inf)
    first, last = energy[..., :part].sum(axis=-1), energy[..., -part:].sum(axis=-1)
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.minimum((last / first) ** (1.0 / 9.0), _SLOWEST)  # of a tenth to the one before
        level = 10.0 * np.log10(last * ratio / (1.0 - ratio) / energy.sum(axis=-1))
    return np.where(np.isfinite(level), level, -np.inf)


def _reason(energy: np.ndarray, bin_s: float, time: float, reached: float, lower_db: float) -> str:
    """Why a time of energies (n,) is NaN; nothing if it is not."""
    if np.isfinite(time):
        return ""
    needed = lower_db - _HEADROOM_DB
    if _cut_off(energy) > needed:
        return (
            f"the decay reaches {reached:.1f} dB, needed {needed:.0f} dB, where the response is cut after "
            f"{energy.shape[-1] * bin_s:.3g} s: make responses longer "
            "(simulation.max_duration, simulation.duration)"
        )
    if reached > needed:
        return f"the decay reaches {reached:.1f} dB, needed {needed:.0f} dB"
    return "fewer than three bins in the evaluated range, or the energy does not decay"


def energy_measures(energy: np.ndarray, bin_s: float, onset_s: float) -> RoomMeasures:
    """Measures of (bands, n) energies; `onset_s` is the direct sound's time."""
    bands = len(energy)
    start = min(int(onset_s / bin_s + 1e-9), energy.shape[1] - 1)
    after = energy[:, start:]
    reasons: list[str] = []
    silent = np.asarray(~after.any(axis=1))
    times = np.empty((3, bands))
    for i, (name, upper, lower) in enumerate(RANGES):
        found, levels = reverberation_times(after, bin_s, upper, lower)
        times[i] = np.where(silent, np.nan, found)
        for b in range(bands):
            reason = "no energy" if silent[b] else _reason(after[b], bin_s, found[b], levels[b], lower)
            if reason:
                reasons.append(f"{name}, band {b}: {reason}")
    t20, t30, edt = times
    return RoomMeasures(t20=t20, t30=t30, edt=edt, reasons=tuple(reasons), **energy_ratios(after, bin_s))


def energy_ratios(after: np.ndarray, bin_s: float) -> dict[str, np.ndarray]:
    """(…) measures of energies (…, n) from the onset on that are ratios of energies."""
    middle = (np.arange(after.shape[-1]) + 0.5) * bin_s
    with np.errstate(divide="ignore", invalid="ignore"):
        total = after.sum(axis=-1)
        return {
            "c50": early_to_late(after, bin_s, 0.05),
            "c80": early_to_late(after, bin_s, 0.08),
            "d50": np.asarray(up_to(after, bin_s, 0.05) / total),
            "ts": np.asarray((after @ middle) / total),
            "drr": early_to_late(after, bin_s, DIRECT_S),
        }


def early_to_late(energy: np.ndarray, bin_s: float, time: float) -> np.ndarray:
    """(…) dB: energy (…, n) up to `time`, to the rest."""
    early = up_to(energy, bin_s, time)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(10.0 * np.log10(early / (energy.sum(axis=-1) - early)))


def up_to(energy: np.ndarray, bin_s: float, time: float) -> np.ndarray:
    """(…) energy (…, n) up to `time`."""
    whole = int(time / bin_s + 1e-9)
    part = energy[..., whole] * (time / bin_s - whole) if whole < energy.shape[-1] else 0.0
    return np.asarray(energy[..., :whole].sum(axis=-1) + part)


def levels_of(echograms: Sequence[Echogram]) -> np.ndarray:
    """(N,) dB: energy of each, all bands, re that of the direct sound at 1 m."""
    energy = []
    for e in echograms:
        arrivals = sum((float(a.energy.sum()) for a in e.arrivals), 0.0)
        energy.append((float(e.energy[:, 0].sum()) + arrivals) / (len(e.bands) - 1))
    with np.errstate(divide="ignore"):
        return np.asarray(10.0 * np.log10(np.array(energy) * 4.0 * np.pi))


def echograms_measures(echoes: Echograms) -> dict[str, np.ndarray]:
    """Every measure of `RoomMeasures`, of every pair, each (S, L, bands), as `room_measures` finds them.

    A reverberation time whose standard error is known and above `LARGEST_ERROR` of it is NaN, as it is not
    measured; so is the direct-to-reverberant ratio of a source out of sight.
    """
    bins = int(np.ceil(max(echoes.time_edges[-1], echoes.early.delay.max(initial=0.0)) / BIN_S)) + 1
    sources, listeners, bands = *echoes.shape, len(echoes.bands) - 1
    step = max(_AT_ONCE // (bins * bands), 1)
    pairs = [(s, l) for s in range(sources) for l in range(0, max(listeners, 1), step)]
    parts: list[dict[str, np.ndarray]] = [{} for _ in pairs]

    def call(first: int, last: int) -> None:
        for k in range(first, last):
            after = _after_onset(echoes, *pairs[k], step, bins)
            curve, reached = _curve_and_depth(after)
            sums = _sums(curve)
            times = {n.lower(): _fitted(curve, sums, reached, BIN_S, *levels) for n, *levels in RANGES}
            parts[k] = {**times, **energy_ratios(after, BIN_S)}

    over_rows(call, len(parts), chunk=1)
    shape = sources, listeners, bands
    out = {name: np.concatenate([part[name] for part in parts]).reshape(shape) for name in parts[0]}
    out["drr"] = np.where(echoes.walls[:, :, None] == 0, out["drr"], np.nan)
    if echoes.measure_error is not None:
        drop_uncertain(out, echoes.measure_error)
    return out


def why_undefined(echogram: Echogram, name: str, band: int) -> str:
    """Why a reverberation time (``t20``, ``t30``, ``edt``) of a band of `echograms_measures` is NaN."""
    begin = f"{name.upper()}, band {band}: "
    found = [r.removeprefix(begin) for r in room_measures(echogram).reasons if r.startswith(begin)]
    if found:
        return found[0]
    return (
        f"its standard error is above {100 * LARGEST_ERROR:.0f} %: take more subpaths (simulation.walks)"
    )


def drop_uncertain(measures: dict[str, np.ndarray], error: np.ndarray) -> None:
    """Make reverberation times (S, L, b) NaN, in place, whose standard error, in (S, L, M, b), is above
    `LARGEST_ERROR` of them."""
    for name in ("t20", "t30", "edt"):
        known = error[:, :, MEASURES.index(name)] <= LARGEST_ERROR * measures[name]
        measures[name] = np.where(known, measures[name], np.nan)


def _after_onset(echoes: Echograms, s: int, first: int, most: int, bins: int) -> np.ndarray:
    """(l, bands, bins) energies of one source in bins of `BIN_S`, from each onset on, at listeners from the `first`
    on, `most` of them."""
    edges = np.minimum(np.arange(bins + 1) * BIN_S, echoes.time_edges[-1])
    # Position of each edge among the stored bins; energy of a bin that is cut is shared by duration.
    k = np.clip(np.searchsorted(echoes.time_edges, edges, "right") - 1, 0, len(echoes.time_edges) - 2)
    share = (edges - echoes.time_edges[k]) / np.diff(echoes.time_edges)[k]
    some = slice(first, first + most)
    stored = np.ascontiguousarray(echoes.energy[s, some, :, 0].swapaxes(1, 2), float)
    before = np.zeros_like(stored)
    np.cumsum(stored[:, :, :-1], axis=2, out=before[:, :, 1:])
    at_edges = before[:, :, k] + share * stored[:, :, k]
    energy = np.maximum(np.diff(at_edges, axis=2), 0.0)
    count, pair = len(energy), s * echoes.shape[1] + first
    start = echoes.early_start[pair : pair + count + 1]
    early, listener = slice(int(start[0]), int(start[-1])), np.repeat(np.arange(count), np.diff(start))
    at = np.minimum((echoes.early.delay[early] / BIN_S + 1e-9).astype(int), bins - 1)
    np.add.at(energy.transpose(0, 2, 1), (listener, at), echoes.early.energy[early])
    of_direct = echoes.direct_energy[s, some]
    delay = echoes.direct_length[s, some] / echoes.speed_of_sound
    direct = np.minimum((delay / BIN_S + 1e-9).astype(int), bins - 1)
    energy[np.arange(count), :, direct] += of_direct
    onset = np.where(of_direct.any(axis=1), direct, first_loud(energy))
    after = np.zeros_like(energy)
    for l, start_bin in enumerate(onset):
        after[l, :, : bins - start_bin] = energy[l, :, start_bin:]
    return after


def first_loud(energy: np.ndarray) -> np.ndarray:
    """(…) number of the first bin of (…, bands, bins) with energy, of all bands, within 20 dB of the peak."""
    whole = energy.sum(axis=-2)
    most = whole.max(axis=-1, keepdims=True)
    return np.asarray(((whole >= ONSET * most) & (whole > 0.0)).argmax(axis=-1))


def room_measures(echogram: Echogram) -> RoomMeasures:
    """Measures of an echogram, per band; the onset is the direct sound's time, or without one when the energy
    first comes within 20 dB of its peak (ISO 3382-1, A.3.4)."""
    energy = echogram.histogram(BIN_S)
    first = float(first_loud(energy)) * BIN_S
    if echogram.direct is not None:
        first = echogram.direct.delay
    found = energy_measures(energy, BIN_S, first)
    if echogram.visible:
        return found
    return replace(
        found,
        drr=np.full_like(found.drr, np.nan),
        reasons=(*found.reasons, "DRR: the source is out of sight"),
    )


def waveform_measures(
    ir: ArrayLike, rate: float, bands: tuple[float, ...] = DEFAULT_BANDS
) -> RoomMeasures:
    """Measures of an omnidirectional pressure response (n,) at `rate` Hz, per band.

    `bands`: edges in Hz; those that begin above Nyquist are left out. The onset is where the response
    first comes within 20 dB of its peak. Bands are cut without phase, inside their edges, so that none
    shows its neighbours' decay. In the lowest band a few early arrivals add up as pressures, in phase,
    where an echogram adds energies: there C50, C80 and EDT of the two differ, by nature.
    """
    energy, onset = band_energies(ir, rate, bands)
    return energy_measures(energy, 1.0 / rate, onset / rate)


def band_energies(
    ir: ArrayLike, rate: float, bands: tuple[float, ...], onset: int | None = None
) -> tuple[np.ndarray, int]:
    """(bands', n) energies of the samples of a response (n,), of bands that begin below Nyquist, and the sample at
    which it starts (`onset`, if that is known); what the filters' ringing puts before that is in it. Raises
    `ConfigError`."""
    response = np.asarray(ir, float)
    if response.ndim != 1 or len(response) < 2 or not np.isfinite(response).all():
        raise ConfigError(f"ir: expected finite values of shape (n,), got {response.shape}")
    n = 2 * len(response)  # room for the filters to ring
    frequency = np.fft.rfftfreq(n, 1.0 / rate)
    gains = np.sqrt(band_windows(bands, frequency, rate))
    energy = np.fft.irfft(np.fft.rfft(response, n) * gains, n, axis=1)[:, : len(response)] ** 2
    if onset is None:
        peak = np.abs(response).max()
        onset = int(np.argmax(np.abs(response) >= 10.0 ** (_ONSET_DB / 20.0) * peak))
    # Filters without phase ring before the onset as well: that is energy of the direct sound.
    energy[:, onset] += energy[:, :onset].sum(axis=1)
    return energy, onset
