"""Denoising, against a slow twin that follows the formulas of its docstrings array by array."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from soundspaces_sim.core.config import DEFAULT_TIME_GRID
from soundspaces_sim.echogram import decay_curves, denoise, pool_windows, wavelets
from soundspaces_sim.echogram.denoise import Noise, smooth_late
from soundspaces_sim.echogram.denoise_plan import WIDEST_S, DenoisePlan, make_denoise_plan

BANDS = 2


def _edges(end: float = 0.6) -> np.ndarray:
    parts = []
    stops = [start for start, _ in DEFAULT_TIME_GRID[1:]] + [np.inf]
    for (start, width), stop in zip(DEFAULT_TIME_GRID, stops, strict=True):
        if start < end:
            parts.append(start + width * np.arange(round((min(stop, end) - start) / width)))
    return np.append(np.concatenate(parts), end)


def _windows(plan: DenoisePlan, low: int, split: int) -> tuple[list[int], list[int]]:
    """Ends of the windows whose energies stay, and of those to which curves are fitted."""
    inner = sorted({*plan.windows.tolist(), min(split, int(plan.windows[-1]))})
    ends, wide = [low], [low]
    for end in (e for e in inner if e > low):
        stretch = int(np.searchsorted(plan.stretches, end)) - 1
        if 2 * (end - wide[-1]) >= 2 ** plan.levels[stretch]:
            wide.append(end)
        elif len(wide) > 1:
            wide[-1] = end
        ends.append(end)
    wide = wide if len(wide) > 1 else [low, ends[-1]]
    return ends, wide if len(wide) > 2 else [low, (low + wide[1]) // 2, wide[1]]


def _fit(
    base: np.ndarray, ends: list[int], sums: np.ndarray, edges: np.ndarray, sloping: bool
) -> np.ndarray:
    """(T,) curve, log-linear between the centres of windows, by which `base` has these sums over windows."""
    middle = 0.5 * (edges[1:] + edges[:-1])
    spans = [slice(*pair) for pair in itertools.pairwise(ends)]
    used = [k for k, span in enumerate(spans) if sums[k] > 0.0 and base[span].sum() > 0.0]
    time = np.array([0.5 * (edges[ends[k]] + edges[ends[k + 1]]) for k in used])
    first, last = edges[ends[used[0]]], edges[ends[used[-1] + 1]]
    initial = np.array([np.log(sums[k] / base[spans[k]].sum()) for k in used])

    def draw(level: np.ndarray) -> np.ndarray:
        before, after = level[0], level[-1]
        if sloping and len(level) > 1:
            slopes = np.diff(level) / np.diff(time)
            before += slopes[0] * (first - time[0])
            after += min(slopes[-1], 0.0) * (last - time[-1])
        knots = np.concatenate([[first], time, [last]])
        return np.asarray(np.exp(np.interp(middle, knots, np.concatenate([[before], level, [after]]))))

    level = initial
    for _ in range(decay_curves._ROUNDS):
        curve = draw(level)
        ratio = np.array([sums[k] / (base * curve)[spans[k]].sum() for k in used])
        far = decay_curves._FARTHEST
        level = np.clip(level + decay_curves._STEP * np.log(ratio), initial - far, initial + far)
    return np.asarray(draw(level))


def _spline(rows: np.ndarray, step: int) -> np.ndarray:
    """(n, …) rows, convolved with the B3 spline of nodes `step` apart; ends are mirrors."""
    padded = np.pad(rows, [(2 * step, 2 * step)] + [(0, 0)] * (rows.ndim - 1), mode="symmetric")
    weights = np.array([1.0, 4.0, 6.0, 4.0, 1.0]) / 16.0
    return np.asarray(sum(w * padded[k * step : k * step + len(rows)] for k, w in enumerate(weights)))


def _pooled(values: np.ndarray, reach: int) -> tuple[np.ndarray, np.ndarray]:
    """(n,) sums over up to `reach` bins on either side, and how many these are."""
    n = len(values)
    spans = [slice(max(t - reach, 0), min(t + reach + 1, n)) for t in range(n)]
    return np.array([values[s].sum() for s in spans]), np.array([len(values[s]) for s in spans])


def _retained(detail: np.ndarray, noise: np.ndarray, step: int) -> np.ndarray:
    """(n,) firm shrinkage by the share of noise in the energy of details, around and near."""

    def firm(noise_energy: np.ndarray, energy: np.ndarray) -> np.ndarray:
        share = np.divide(noise_energy, energy, out=np.zeros_like(energy), where=energy > 0.0)
        width = wavelets._REMOVE - wavelets._RETAIN
        return np.asarray(np.clip((wavelets._REMOVE - share) / width, 0.0, 1.0))

    around, count = _pooled(noise, 2 * wavelets._AROUND * step)
    stays = firm(around, _pooled(detail**2, 2 * wavelets._AROUND * step)[0])
    near, few = _pooled(noise, 2 * wavelets._NEAR * step)
    near = np.maximum(near, around / count * few)
    stays_near = firm(near, _pooled(detail**2, 2 * wavelets._NEAR * step)[0])
    return np.asarray(np.maximum(stays, stays_near))


def _means(
    values: np.ndarray, energy: np.ndarray, f: np.ndarray, wide: list[int], edges: np.ndarray
) -> np.ndarray:
    """(T, …) f times the ratio of `values` to `energy` over windows, linear between their centres."""
    centre = np.array([0.5 * (edges[a] + edges[b]) for a, b in itertools.pairwise(wide)])
    middle = 0.5 * (edges[1:] + edges[:-1])
    out = np.empty((len(middle), *values.shape[1:]))
    for t, time in enumerate(middle):
        weight = np.array([np.interp(time, centre, row) for row in np.eye(len(centre))]) * (energy > 0.0)
        ratio = values / np.maximum(energy, 1e-300).reshape(-1, *[1] * (values.ndim - 1))
        out[t] = f[t] * np.tensordot(weight / max(weight.sum(), 1e-300), ratio, axes=1)
    return out


def _groups(
    energy: np.ndarray, noise: np.ndarray, first: int, wide: list[int], edges: np.ndarray
) -> tuple[list[list[int]], np.ndarray]:
    """Windows that share their energy, and the decay of groups: the first group at whose centre the curve is above
    that at the centre of the one before, while it is not known, is joined with it."""
    groups, width = [[w] for w in range(len(energy))], np.diff(edges)
    middle = 0.5 * (edges[1:] + edges[:-1])
    while True:
        between = [wide[group[0]] for group in groups] + [wide[-1]]
        totals = np.array([energy[group].sum() for group in groups])
        curve = _fit(width, between, totals, edges, True)
        centres = [0.5 * (edges[a] + edges[b]) for a, b in itertools.pairwise(between)]
        level = np.interp(centres, middle, np.log(curve))
        sounding = np.flatnonzero(totals > 0.0).tolist()
        for before, own in itertools.pairwise(sounding):
            unknown = noise[groups[own]].sum() > (pool_windows._KNOWN * totals[own]) ** 2
            if level[own] > level[before] and unknown and groups[before][0] >= first:
                groups[before : own + 1] = [list(range(groups[before][0], groups[own][-1] + 1))]
                break
        else:
            return groups, width * curve


def _spread(
    row: np.ndarray, noise: np.ndarray, ends: list[int], wide: list[int], split: int, edges: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Energies between `ends`, and sums of energies and of D between `wide`, after groups have shared theirs."""
    kept = np.add.reduceat(row[:, 0], ends[:-1])
    sums, of_noise = np.add.reduceat(row, wide[:-1], axis=0), np.add.reduceat(noise, wide[:-1])
    first = int(np.searchsorted(wide[:-1], split))
    groups, f = _groups(sums[:, 0], np.add.reduceat(noise**2, wide[:-1]), first, wide, edges)
    for group in groups:
        low, high = wide[group[0]], wide[group[-1] + 1]
        if len(group) > 1:
            shares = np.array([f[wide[w] : wide[w + 1]].sum() for w in group]) / f[low:high].sum()
            sums[group] = shares[:, None] * sums[group].sum(axis=0)
            of_noise[group] = shares * of_noise[group].sum()
            inside = [v for v in range(len(kept)) if low <= ends[v] < high]
            parts = np.array([f[ends[v] : ends[v + 1]].sum() for v in inside])
            kept[inside] = parts / f[low:high].sum() * kept[inside].sum()
    return kept, sums, of_noise


def _noise(
    raw: np.ndarray, difference: np.ndarray, error: np.ndarray, window: np.ndarray, plan: DenoisePlan
) -> np.ndarray:
    """(late bins, b) D with what it lacks of the variance by batches, of windows in one piece."""
    out, count, of_late = difference.copy(), len(error), window[plan.first :]
    d = np.zeros(raw[:, 0].shape)
    d[plan.first :] = difference
    own = np.maximum(raw[:, 0] ** 2 - d**2, 0.0)
    for b in range(BANDS):
        squares, energy, known = (np.bincount(window, x[:, b], count) for x in (own, raw[:, 0], d**2))
        lacks = np.maximum(error[:, b] ** 2 - known, 0.0) ** 0.5
        lacks[error[:, b] ** 2 <= denoise._LACKING * known] = 0.0
        for t, w in enumerate(of_late):
            inside = np.flatnonzero(of_late == w)
            near = w - 1 if t < 0.5 * (inside[0] + inside[-1]) else w + 1
            lack = lacks[w]
            long = plan.edges[inside[-1] + 1] - plan.edges[inside[0]] > WIDEST_S
            if long and 0 <= near < count and energy[near] > 0.0:
                lack += lacks[near] * max(1.0, energy[w] / energy[near])
            share = min(lack**2 / squares[w], 1.0) if squares[w] > 0.0 else 0.0
            size = np.sqrt(out[t, b] ** 2 + share * own[plan.first + t, b])
            out[t, b] = np.copysign(size, out[t, b])
    return out


def _smoothed_band(row: np.ndarray, noise: np.ndarray, split: int, plan: DenoisePlan) -> np.ndarray:
    """(late bins, 9) of one band, from the late bins `row` (T, 9), energies alike in all bands, and D `noise` (T,)."""
    edges, low = plan.edges, int(np.argmax(row[:, 0] > 0.0))
    ends, wide = _windows(plan, low, split)
    kept_energy, sums, of_windows = _spread(row, noise, ends, wide, split, edges)
    width = np.diff(edges)
    f = width * _fit(width, wide, sums[:, 0], edges, True)
    broad = _means(sums, sums[:, 0], f, wide, edges)
    broad_noise = _means(of_windows, sums[:, 0], f, wide, edges)
    out = np.zeros_like(row)
    for k, levels in enumerate(plan.levels.tolist()):
        span = slice(max(int(plan.stretches[k]), low), int(plan.stretches[k + 1]))
        if span.stop <= low:
            continue
        while levels > 0 and 2 * 2**levels > span.stop - span.start:
            levels -= 1
        if levels <= 0:
            out[span] = row[span]
            continue
        scale, kept = [row[span], noise[span], f[span]], np.zeros(span.stop - span.start)
        for level in range(levels + 1):
            coarser = [_spline(x, 2**level) for x in scale]
            if level == levels:
                coarser = [broad[span], broad_noise[span], f[span]]
            detail = scale[0][:, 0] / scale[2] - coarser[0][:, 0] / coarser[2]
            of_noise = scale[1] / scale[2] - coarser[1] / coarser[2]
            noisy = denoise._BLUR if level < plan.blurred[k] else 1.0
            stays = np.maximum(_retained(detail, noisy * of_noise**2, 2**level), kept)
            out[span] += ((stays - kept) * f[span] / scale[2])[:, None] * scale[0]
            scale, kept = coarser, stays
        out[span] += ((1.0 - kept) * f[span] / scale[2])[:, None] * scale[0]
    factor = _fit(out[:, 0], wide, sums[:, 0], edges, False)
    for (a, b), stays in zip(itertools.pairwise(ends), kept_energy, strict=True):
        energy = (factor * out[:, 0])[a:b].sum()
        out[a:b] *= factor[a:b, None] * (stays / energy if energy > 0.0 else 0.0)
    return out


@pytest.mark.parametrize("lucky", [(), (60,), (40, 61), (58, 79)])
@pytest.mark.parametrize(("onset", "split"), [(0, 20), (3, 33), (12, 0)])
def test_smoothed_bins_are_those_of_the_formulas(onset: int, split: int, lucky: tuple[int, ...]) -> None:
    """A noisy decay with an echo, in both bands, which have other noise; nothing arrives before the onset. Some bins
    hold what one lucky subpath of one end has brought."""
    edges, rng = _edges(), np.random.default_rng(onset)
    plan = make_denoise_plan(edges, 0.05, 2.0 / 343.0)
    decay = np.diff(-np.exp(-23.0 * edges))[:, None] * np.ones(BANDS)
    decay[plan.first + 30] *= 5.0
    halves = 0.5 * decay * rng.gamma(4.0, 0.25, (2, *decay.shape))
    for k in lucky:
        halves[0, plan.first + k] *= 60.0
    table = np.zeros((1, 1, len(decay), 9, BANDS), np.float32)
    table[0, 0, :, 0] = halves.sum(axis=0)
    table[0, 0, :, 1:] = table[0, 0, :, :1] * rng.uniform(-1.0, 1.0, (len(decay), 8, BANDS))
    table[0, 0, : plan.first + onset] = 0.0
    difference = (halves[0] - halves[1])[None, None, plan.first :].astype(np.float32)
    raw = table[0, 0].astype(float)
    window = np.minimum(np.arange(len(raw)) // 40, 2)
    energy = np.add.reduceat(raw[:, 0], [0, 40, 80])
    error = np.array([[0.1], [0.6], [0.05]]) * energy
    noise = Noise(difference, error[None, None].astype(np.float32), window)
    smooth_late(table, noise, np.full((1, 1), plan.first + split), plan)
    d = _noise(raw, difference[0, 0].astype(float), error, window, plan)
    raw = raw[plan.first :]
    for band in range(BANDS):
        expected = _smoothed_band(raw[:, :, band], d[:, band], split, plan)
        found = table[0, 0, plan.first :, :, band]
        np.testing.assert_allclose(found, expected, rtol=2e-4, atol=1e-6 * expected.max())
        assert not np.allclose(expected, raw[:, :, band], rtol=0.05)
