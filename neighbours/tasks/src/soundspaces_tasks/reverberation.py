"""Task: T60, C50 and DRR at 775 to 3409 Hz from four seconds of reverberant speech in noise.

Labels are those of the dataset's table with their standard errors. T60 is T30, and its logarithm is estimated.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.signal import savgol_filter

from soundspaces_sim import open_dataset
from soundspaces_sim.parts import Interval
from soundspaces_tasks.baselines import Example, gathered, trained_rows
from soundspaces_tasks.fits import ridge, weighted_mean
from soundspaces_tasks.results import Row, Score, TaskResult, interval, root
from soundspaces_tasks.setting import RATE, HomeJob, Setting
from soundspaces_tasks.speech import HOP, dry_speech, heard, log_energies, mel_bands, spectra

BAND = 2  # 775 to 3409 Hz
SECONDS, MELS = 4.0, 32
_STREAM = 1
_WINDOW = 11  # frames of a slope: 0.18 s
_GROUPS = 8  # of mel bands whose decay rates go together
_SCORES = (
    Score("T60, %", digits=1),
    Score("C50, dB"),
    Score("DRR, dB"),
)
_ABOUT = f"""Given {SECONDS:g} s of speech at one omnidirectional microphone, with white noise 20 to 40 dB below
it: what are T60 (as T30), C50 and the direct-to-reverberant ratio at 775 to 3409 Hz? Levels are normalised. DRR
is asked of pairs in sight alone.

A label y has a standard error σ, that of the simulation. Loss and score weight an example by w = 1 / (σ² + s²),
with s the standard deviation of the labels in all training homes. The score is sqrt(Σ w [(ŷ − y)² − σ²] / Σ w):
the root mean square error without what the labels' own noise adds. T60 is scored by its natural logarithm,
times 100.

- *training mean*: the weighted mean of the labels in the training homes.
- *decay rates*: the distribution of signal decay rates (Wen, Habets and Naylor, ICASSP 2008): root mean square
  of the negative slopes of log energies over {1e3 * _WINDOW * HOP / RATE:.0f} ms, in {_GROUPS} groups of mel
  bands, and a ridge regression on their logarithms fitted in the training homes.
- *network*: log-mel energies, two convolutions over time, a GRU, trained with the weights above."""


class Examples(NamedTuple):
    """Of all homes: log-mel energies (n, frames, mels), decay-rate features (n, f), labels and their
    standard errors (n, 3) of ln T60, C50 and DRR (NaN where there is none), and the row of each one's home."""

    mel: np.ndarray
    rates: np.ndarray
    labels: np.ndarray
    errors: np.ndarray
    home: np.ndarray


def decay_rates(log_energy: np.ndarray) -> np.ndarray:
    """(frames, bands) slopes of (frames, bands) dB in dB/s: least squares over `_WINDOW` frames."""
    step = HOP / RATE
    return np.asarray(savgol_filter(log_energy, _WINDOW, 1, deriv=1, delta=step, axis=0, mode="interp"))


def rate_features(log_energy: np.ndarray) -> np.ndarray:
    """(2 `_GROUPS`,) of (frames, bands) dB: logarithms of the root mean square of negative slopes (the
    negative-side variance, mirrored) and of their median, per group of bands."""
    rates = decay_rates(log_energy)
    found = []
    for part in np.array_split(rates, _GROUPS, axis=1):
        falling = part[part < 0.0]
        falling = falling if len(falling) else np.array([-1.0])  # dB/s: nothing decays
        found += [np.log(np.sqrt(np.mean(falling**2))), np.log(-np.median(falling))]
    return np.array(found)


def labels_of(rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(n, 3) labels and standard errors of rows of a table; NaN without a finite value and a finite error."""
    t30, error = rows[f"t30_{BAND}"].astype(float), rows[f"t30_error_{BAND}"].astype(float)
    values = np.stack([np.log(t30), rows[f"c50_{BAND}"], rows[f"drr_{BAND}"]], axis=1)
    errors = np.stack([error / t30, rows[f"c50_error_{BAND}"], rows[f"drr_error_{BAND}"]], axis=1)
    known = np.isfinite(values) & np.isfinite(errors)
    return np.where(known, values, np.nan), np.where(known, errors, np.nan)


def heard_mel(response: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """(frames, `MELS`) float32 log-mel energies of drawn speech in noise through a response (1, n)."""
    sound = heard(dry_speech(SECONDS, rng), response, rng)[0]
    return log_energies(np.abs(spectra(sound)) ** 2, mel_bands(MELS)).astype(np.float32)


def make_home(job: HomeJob) -> list[Example]:
    """Log-mel energies, decay-rate features, labels and errors of each of a home's pairs."""
    rng = job.rng(_STREAM)
    with open_dataset(job.folder, rate=RATE) as ds:
        table = ds.table()
        table = table[np.isfinite(table[f"t30_{BAND}"]) & np.isfinite(table[f"t30_error_{BAND}"])]
        seen = table["visible"] == 1  # half of the pairs are in sight, where as many are: DRR needs them
        drawn = [part[rng.permutation(len(part))] for part in (table[seen], table[~seen])]
        few = min(len(drawn[0]), max(job.pairs // 2, job.pairs - len(drawn[1])))
        rows = np.concatenate([drawn[0][:few], drawn[1][: job.pairs - few]])
        mel = [heard_mel(ds.monaural(int(row["source"]), int(row["listener"])), rng) for row in rows]
    return list(zip(mel, map(rate_features, mel), *labels_of(rows), strict=True))


def label_weights(labels: np.ndarray, errors: np.ndarray, spread: np.ndarray) -> np.ndarray:
    """(n, k) 1 / (σ² + s²), 0 where there is no label."""
    return np.where(np.isfinite(labels), 1.0 / (np.nan_to_num(errors) ** 2 + spread**2), 0.0)


def weighted_scores(
    predicted: np.ndarray, labels: np.ndarray, errors: np.ndarray, weights: np.ndarray, home: np.ndarray
) -> list[Interval]:
    """Of (S, n, k) predictions, per label: the root of the weighted mean of squared errors less those of labels."""
    squares = (predicted - labels) ** 2 - errors**2
    return [
        interval(squares[..., k], home, np.nan_to_num(weights[:, k]), root)
        for k in range(labels.shape[1])
    ]


def run(setting: Setting) -> TaskResult:
    """Scores of all baselines."""
    data = Examples._make(gathered(setting, make_home))
    pool = setting.within("train", data.home)
    spread = np.nanstd(data.labels[pool], axis=0)
    weights = label_weights(data.labels, data.errors, spread)
    test = setting.within("test", data.home)

    def row(name: str, count: int, found: list[np.ndarray]) -> Row:
        of_test = data.labels[test], data.errors[test], weights[test], data.home[test]
        return Row(name, count, _in_units(weighted_scores(np.stack(found), *of_test)))

    methods = {"training mean": _mean, "decay rates": _decay_rates}
    rows, left_out = trained_rows(setting, "reverberation", methods, [data, weights], row, "%")
    noise = [
        interval(data.errors[None, test, k] ** 2, data.home[test], weights[test, k], root)
        for k in range(3)
    ]
    rows.append(Row("standard errors of the labels", 0, _in_units(noise)))
    facts = (
        f"{int(pool.sum())} examples of {len(setting.rows('train'))} training homes, {int(test.sum())} of "
        f"{len(setting.rows('test'))} test homes; standard deviations of the labels {100 * spread[0]:.0f} % (T60), "
        f"{spread[1]:.1f} dB (C50) and {spread[2]:.1f} dB (DRR).",
    )
    return TaskResult(
        "T60, C50 and DRR from reverberant speech",
        _ABOUT,
        _SCORES,
        tuple(rows),
        (*facts, *left_out),
    )


def _in_units(scores: list[Interval]) -> tuple[Interval, ...]:
    first = scores[0]
    return (
        Interval(*(100.0 * x for x in (first.mean, first.low, first.high, first.error))),
        *scores[1:],
    )


def _mean(data: Examples, weights: np.ndarray, setting: Setting, count: int, seed: int) -> np.ndarray:
    use = setting.trained_on(count, seed, data.home)
    test = setting.within("test", data.home)
    return np.tile(weighted_mean(data.labels[use], weights[use]), (int(test.sum()), 1))


def _decay_rates(
    data: Examples, weights: np.ndarray, setting: Setting, count: int, seed: int
) -> np.ndarray:
    use = setting.trained_on(count, seed, data.home)
    fit = ridge(data.rates[use], data.labels[use], weights[use])
    return fit(data.rates[setting.within("test", data.home)])
