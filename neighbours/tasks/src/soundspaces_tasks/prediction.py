"""Task: the energy decay between a source and a listener, from a few responses of other sources at that
listener."""

from __future__ import annotations

import numpy as np

from soundspaces_sim import RirDataset, open_dataset
from soundspaces_sim.parts import BIN_S, first_loud
from soundspaces_tasks.baselines import Example, gathered, trained_rows
from soundspaces_tasks.decays import KNOTS_S, REFERENCES, Examples, curve_of, measures_of
from soundspaces_tasks.results import Row, Score, TaskResult, interval
from soundspaces_tasks.setting import RATE, HomeJob, Setting

BAND = 2  # 775 to 3409 Hz
_STREAM = 3
_LEAST_M = 0.1  # added to distances, of whose inverse the weights are
_SEEN_DB = -30.0  # to which decays are compared
_NORMAL_MEAN = np.sqrt(2.0 / np.pi)  # mean magnitude of a normal variable of standard deviation 1
_SCORES = (
    Score("T30, %", digits=1),
    Score("C50, dB"),
    Score("EDT, ms", digits=0),
    Score("Decay, dB"),
    Score("Level, dB"),
)
_ABOUT = f"""Given {REFERENCES} responses of other sources at a listener and the positions of all points, but no
geometry: how does the energy from an unheard source decay there? Homes of the tests were not seen in training.
References are drawn at random. A prediction is the decay curve at 775 to 3409 Hz in bins of 1 ms from its
onset on (Schroeder's backward integral, dB for 1 J emitted); when it begins is not scored.

Scores are mean magnitudes of differences: of T30 in per cent of it, C50 and EDT of the predicted and the
simulated decay, as in the literature on few-shot prediction (Liu et al., "Hearing Anywhere in Any Environment",
CVPR 2025, whose data and responses differ, so that numbers cannot be compared); of the normalised decay curve
over the time in which the simulated one falls by 30 dB; and of its level. What is not measured in the
simulation is not scored.

- *training mean*: the mean curve of all references in the training homes, level too.
- *nearest*: the reference whose source is nearest to the unheard one.
- *mean*, *inverse distance*: means of the references' curves in dB, the latter weighted by the inverse distance
  of the sources.
- *network*: a mean of the references with learnt weights and a learnt correction, from distances and the curves
  at {len(KNOTS_S)} times."""


def _decay(ds: RirDataset, s: int, l: int) -> np.ndarray:
    """The curve of a pair, from the onset on that `room_measures` takes."""
    echogram = ds.echogram(s, l)
    energy = echogram.histogram(BIN_S)
    first = int(first_loud(energy))
    if echogram.direct is not None:
        first = int(echogram.direct.delay / BIN_S + 1e-9)
    return curve_of(energy[BAND, first:])


def make_home(job: HomeJob) -> list[Example]:
    """Curve, references, distances, labels and errors of each of a home's targets."""
    rng = job.rng(_STREAM)
    with open_dataset(job.folder, rate=RATE) as ds:
        table, points = ds.table(), ds.points
        rows = table[rng.permutation(len(table))[: job.pairs]]
        others = min(REFERENCES, len(points) - 2)
        curves, references, distances = [], [], []
        for row in rows:
            s, l = int(row["source"]), int(row["listener"])
            near = rng.permutation(np.setdiff1d(np.arange(len(points)), (s, l)))[:others]
            near = np.resize(
                near, REFERENCES
            )  # of a home with few points some references are given twice
            curves.append(_decay(ds, s, l))
            references.append([_decay(ds, int(k), l) for k in near])
            apart = [np.linalg.norm(points[near] - points[at], axis=1) for at in (l, s)]
            distances.append([row["distance"], *apart[0], *apart[1]])
        names = [f"{name}_{BAND}" for name in ("t30", "c50", "edt")]
        labels = np.stack([rows[n] for n in names], axis=1).astype(float)
        errors = np.stack([rows[n.replace("_", "_error_")] for n in names], axis=1).astype(float)
    known = np.isfinite(labels) & np.isfinite(errors)
    heard = (np.array(x, np.float32) for x in (curves, references, distances))
    told = (np.where(known, x, np.nan) for x in (labels, errors))
    return list(zip(*heard, *told, strict=True))


def differences(predicted: np.ndarray, data: Examples, rows: np.ndarray) -> np.ndarray:
    """(n, 5) magnitudes of differences of predicted curves (n, LENGTH): T30 in %, C50 in dB, EDT in ms,
    decay and level in dB. NaN where the simulation does not measure what is asked; a
    prediction without a T30 or EDT counts as 0 s."""
    out = np.empty((len(rows), len(_SCORES)))
    for k, (curve, row) in enumerate(zip(predicted, rows, strict=True)):
        found, true = measures_of(curve), data.labels[row]
        aim = data.curve[row]
        seen = aim - aim[0] >= _SEEN_DB
        off = np.abs(np.where(np.isnan(found), 0.0, found) - true)  # no decay: off by all of it
        shape = np.abs((curve - curve[0]) - (aim - aim[0]))[seen].mean()
        out[k] = 100.0 * off[0] / true[0], off[1], 1e3 * off[2], shape, abs(curve[0] - aim[0])
    return out


def run(setting: Setting) -> TaskResult:
    """Scores of all baselines."""
    data = Examples._make(gathered(setting, make_home))
    test = np.flatnonzero(setting.within("test", data.home))
    rows = []
    for name, weights in (("nearest", nearest), ("mean", mean), ("inverse distance", inverse_distance)):
        share = weights(data.distances[test])
        found = np.einsum("nk,nkt->nt", share, data.references[test])
        rows.append(_row(name, 0, differences(found, data, test)[None], data.home[test]))
        setting.say(f"prediction, {name}: {rows[-1].scores[0]} %")

    def row(name: str, count: int, found: list[np.ndarray]) -> Row:
        off = np.stack([differences(curves, data, test) for curves in found])
        return _row(name, count, off, data.home[test])

    trained, left_out = trained_rows(
        setting, "prediction", {"training mean": _training_mean}, [data], row, "%"
    )
    rows += [*trained, _noise(data, test)]
    facts = (
        f"{len(data.home)} targets of {len(setting.names)} homes, {len(test)} of test homes, mean distance of the "
        f"nearest reference's "
        f"source {data.distances[test, 1 + REFERENCES :].min(axis=1).mean():.1f} m. All "
        "pairs of a home share subpaths, so a difference may be less than the standard errors of two labels.",
    )
    return TaskResult(
        "Decays at unseen points",
        _ABOUT,
        _SCORES,
        tuple(rows),
        (*facts, *left_out),
    )


def nearest(distances: np.ndarray) -> np.ndarray:
    """(n, K) weights: 1 for the reference whose source is nearest to the target's."""
    apart = distances[:, 1 + REFERENCES :]
    return np.asarray(np.arange(REFERENCES) == apart.argmin(axis=1)[:, None], float)


def mean(distances: np.ndarray) -> np.ndarray:
    """(n, K) equal weights."""
    return np.full((len(distances), REFERENCES), 1.0 / REFERENCES)


def inverse_distance(distances: np.ndarray) -> np.ndarray:
    """(n, K) weights of the inverse distance of sources."""
    inverse = 1.0 / (distances[:, 1 + REFERENCES :] + _LEAST_M)
    return np.asarray(inverse / inverse.sum(axis=1, keepdims=True))


def _training_mean(data: Examples, setting: Setting, count: int, seed: int) -> np.ndarray:
    use = setting.trained_on(count, seed, data.home)
    test = setting.within("test", data.home)
    return np.tile(data.references[use].mean(axis=(0, 1)), (int(test.sum()), 1))


def _row(name: str, count: int, off: np.ndarray, home: np.ndarray) -> Row:
    """Of (S, n, scores) differences."""
    return Row(name, count, tuple(interval(off[..., k], home) for k in range(off.shape[2])))


def _noise(data: Examples, test: np.ndarray) -> Row:
    """What the labels' standard errors alone would score."""
    errors = _NORMAL_MEAN * data.errors[test]
    relative = 100.0 * errors[:, 0] / data.labels[test, 0]
    values = (relative, errors[:, 1], 1e3 * errors[:, 2])
    found = tuple(interval(v[None], data.home[test]) for v in values)
    return Row("standard errors of the labels", 0, (*found, None, None))
