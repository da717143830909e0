"""Task: speech without its late reverberation, from one microphone, by gains of a spectrogram."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from soundspaces_sim import open_dataset
from soundspaces_tasks.baselines import Example, gathered, trained_rows
from soundspaces_tasks.results import Row, Score, TaskResult, interval
from soundspaces_tasks.setting import RATE, HomeJob, Setting
from soundspaces_tasks.speech import HOP, dry_speech, heard, signal_of, spectra

BAND = 2  # of T60, 775 to 3409 Hz
SECONDS = 2.0
EARLY_S = 0.05  # after the direct sound: what is wanted
_STREAM = 4
_SMOOTHING = 0.9  # of power from frame to frame
_LEAST_GAIN = 0.1
_RANGE_DB = 50.0  # of spectra that are compared, below the target's peak
_SCORES = (
    Score("SI-SDR, dB", higher=True),
    Score("Log-spectral distance, dB"),
)
_ABOUT = f"""Given {SECONDS:g} s of reverberant speech at one omnidirectional microphone, with white noise 20 to
40 dB below it: restore the direct sound and the first {1e3 * EARLY_S:.0f} ms of reflections. Every method
multiplies the spectrogram of what is heard (32 ms, half overlapped) by gains between 0 and 1 and keeps its
phases.

Scores: scale-invariant signal-to-distortion ratio (Le Roux et al., ICASSP 2019); root mean square difference of
spectra in dB over frequency, the mean over time (Gray and Markel 1976), after a common gain and not further
than {_RANGE_DB:g} dB below the target's peak. No score of intelligibility is taken: the speech has no words.

- *unprocessed*.
- *spectral subtraction*: late reverberation's power is the smoothed power {1e3 * EARLY_S:.0f} ms before, less
  what an exponential decay loses in that time (Lebart, Boucher and Denbigh, Acta Acustica 2001), with the mean
  T60 of the training homes; gains not below {_LEAST_GAIN:g}. *T60 known*: with the pair's own.
- *network*: a GRU over frames that estimates the gains, trained on the difference of compressed magnitudes."""


class Examples(NamedTuple):
    """Of all homes: what is heard (n, samples), what is wanted of it, T60 (n,) in s, rows of homes (n,)."""

    heard: np.ndarray
    wanted: np.ndarray
    t60: np.ndarray
    home: np.ndarray


def si_sdr(estimate: np.ndarray, target: np.ndarray) -> float:
    """dB of the part of an estimate (n,) that is a multiple of the target (n,), to the rest."""
    part = (estimate @ target) / (target @ target) * target
    rest = estimate - part
    return float(10.0 * np.log10((part @ part) / max(float(rest @ rest), 1e-20 * float(part @ part))))


def spectral_distance(estimate: np.ndarray, target: np.ndarray) -> float:
    """dB: root mean square over frequency of the difference of log spectra, mean over time, of (n,) signals."""
    least = 10.0 ** (-_RANGE_DB / 20.0)
    of_target = np.abs(spectra(target))
    of_target /= of_target.max()
    own = np.abs(spectra(estimate))
    own *= np.sqrt((of_target**2).sum() / max(float((own**2).sum()), 1e-30))
    off = 20.0 * np.log10(np.maximum(own, least) / np.maximum(of_target, least))
    return float(np.sqrt((off**2).mean(axis=1)).mean())


def late_power(power: np.ndarray, t60: float) -> np.ndarray:
    """(frames, bins) power of the reverberation from `EARLY_S` on, of (frames, bins) powers of speech in a room
    that decays exponentially."""
    smooth = np.empty_like(power)
    now = power[0]
    for k, frame in enumerate(power):
        now = _SMOOTHING * now + (1.0 - _SMOOTHING) * frame
        smooth[k] = now
    frames = round(EARLY_S * RATE / HOP)
    late = np.zeros_like(power)
    late[frames:] = smooth[:-frames] * 10.0 ** (-6.0 * frames * HOP / RATE / t60)
    return late


def subtraction_gains(power: np.ndarray, t60: float) -> np.ndarray:
    """(frames, bins) gains of spectral subtraction of magnitudes."""
    with np.errstate(divide="ignore", invalid="ignore"):
        kept = 1.0 - np.sqrt(late_power(power, t60) / power)
    return np.clip(np.nan_to_num(kept, nan=1.0, neginf=0.0), _LEAST_GAIN, 1.0)


def with_gains(signal: np.ndarray, gains: np.ndarray) -> np.ndarray:
    """(n,) a signal whose spectrogram is multiplied by (frames, bins)."""
    return signal_of(gains * spectra(signal), len(signal))


def make_home(job: HomeJob) -> list[Example]:
    """What is heard, what is wanted, and T60, of each of a home's pairs."""
    rng = job.rng(_STREAM)
    found: list[Example] = []
    with open_dataset(job.folder, rate=RATE) as ds:
        table = ds.table()
        table = table[(table["visible"] == 1) & np.isfinite(table[f"t30_{BAND}"])]
        for row in table[rng.permutation(len(table))[: job.pairs]]:
            response = ds.monaural(int(row["source"]), int(row["listener"])).astype(float)
            c = ds.manifest.config.simulation.c
            early = response.copy()
            early[:, round((float(row["distance"]) / c + EARLY_S) * RATE) :] = 0.0
            dry = dry_speech(SECONDS, rng)
            both = heard(dry, response, rng)[0], heard(dry, early)[0]
            found.append((*(x.astype(np.float32) for x in both), float(row[f"t30_{BAND}"])))
    return found


def run(setting: Setting) -> TaskResult:
    """Scores of all baselines."""
    data = Examples._make(gathered(setting, make_home))
    test = np.flatnonzero(setting.within("test", data.home))
    known = [subtraction_gains(_power(data.heard[k]), data.t60[k]) for k in test]
    rows = [
        _row("unprocessed", 0, [[None] * len(test)], data, test),
        _row("spectral subtraction, T60 known", 0, [known], data, test),
    ]
    trained, left_out = trained_rows(
        setting,
        "dereverberation",
        {"spectral subtraction": _subtraction},
        [data],
        lambda name, count, gains: _row(name, count, gains, data, test),
        "dB of SI-SDR",
    )
    facts = (
        f"{len(data.home)} pairs in sight of {len(setting.names)} homes, {len(test)} of test homes; median T60 "
        f"{np.median(data.t60[test]):.2f} s.",
        *left_out,
    )
    return TaskResult("Dereverberation", _ABOUT, _SCORES, (*rows, *trained), facts)


def _power(signal: np.ndarray) -> np.ndarray:
    return np.asarray(np.abs(spectra(signal)) ** 2)


def _row(
    name: str, count: int, gains: Sequence[Sequence[np.ndarray | None]], data: Examples, test: np.ndarray
) -> Row:
    """Scores with gains of S seeds and n examples; None: as heard. Edges that one frame covers are left out."""
    inside = slice(HOP, -HOP)
    found = np.empty((len(_SCORES), len(gains), len(test)))
    for seed, of_seed in enumerate(gains):
        for k, (row, gain) in enumerate(zip(test, of_seed, strict=True)):
            signal = np.asarray(data.heard[row], float)
            made = (signal if gain is None else with_gains(signal, gain))[inside]
            target = np.asarray(data.wanted[row], float)[inside]
            found[:, seed, k] = si_sdr(made, target), spectral_distance(made, target)
    return Row(name, count, tuple(interval(values, data.home[test]) for values in found))


def _subtraction(data: Examples, setting: Setting, count: int, seed: int) -> list[np.ndarray]:
    t60 = float(data.t60[setting.trained_on(count, seed, data.home)].mean())
    test = np.flatnonzero(setting.within("test", data.home))
    return [subtraction_gains(_power(data.heard[k]), t60) for k in test]
