"""Late bins: what is noise is averaged, what is not stays, and sums stay."""

import numpy as np
import pytest

import soundspaces_sim as ss
from soundspaces_sim.core.config import DEFAULT_TIME_GRID
from soundspaces_sim.core.io.resources import resource
from soundspaces_sim.echogram.denoise import Noise, smooth_late
from soundspaces_sim.echogram.denoise_plan import DenoisePlan, make_denoise_plan
from soundspaces_sim.transport.integrator import run_techniques, simulate_tile, traced
from soundspaces_sim.transport.model import EARLY_S
from soundspaces_sim.transport.paths import detector
from soundspaces_sim.transport.preparation import make_model
from soundspaces_sim.transport.simulate import simulate_pairs
from tests.marks import ci_slow
from tests.rooms import box, plain, table, two_rooms
from tests.stats import assert_mean
from tests.transport.test_agreement import MIXED
from tests.transport.test_closed_forms import LISTENER, SIZE, SOURCE, _image_sources

BLUR = 2.0 / 343.0
RUNS, BANDS = 200, 4


def _edges(grid: tuple[tuple[float, float], ...] = DEFAULT_TIME_GRID, end: float = 0.8) -> np.ndarray:
    grid = tuple(span for span in grid if span[0] < end)
    parts = [
        np.arange(round((stop - start) / width)) * width + start
        for (start, width), stop in zip(grid, [g[0] for g in grid[1:]] + [end], strict=True)
    ]
    return np.append(np.concatenate(parts), end)


EDGES = _edges()
EVEN = _edges(((0.0, 0.01),), 1.0)
DECAY = 13.8 / 0.6  # 1/s, of a reverberation time of 0.6 s


def _decaying(edges: np.ndarray, rate: float = DECAY) -> np.ndarray:
    """(bins, b) energies of an exponential decay."""
    falling = np.exp(-rate * edges)
    return np.repeat(((falling[:-1] - falling[1:]) / rate)[:, None], BANDS, axis=1)


def _smoothed(
    raw: np.ndarray, difference: np.ndarray, edges: np.ndarray, split: int = 0
) -> tuple[np.ndarray, DenoisePlan]:
    """(runs, bins, b) of the same; the moments are of random directions."""
    plan = make_denoise_plan(edges, 0.05, BLUR)
    table = np.zeros((1, *raw.shape[:2], 9, BANDS), np.float32)
    table[0, :, :, 0] = raw
    ratio = np.random.default_rng(7).uniform(-1.0, 1.0, (*raw.shape[:2], 8, BANDS))
    table[0, :, :, 1:] = ratio * raw[:, :, None]
    late = np.ascontiguousarray(difference[None, :, plan.first :], np.float32)
    noise = Noise(
        late, np.zeros((*late.shape[:2], 1, BANDS), np.float32), np.zeros(table.shape[2], np.int64)
    )
    smooth_late(table, noise, np.full((1, len(raw)), split), plan)
    within = np.abs(table[0, :, :, 1:]) <= table[0, :, :, :1] * (1.0 + 1e-5)
    assert within.all() and (table[0, :, :, 0] >= 0.0).all()
    return table[0, :, :, 0].astype(float), plan


def _noisy(truth: np.ndarray, relative: float, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """`RUNS` draws of energies of this relative standard error, sums of two gamma distributed halves, and the
    halves' differences."""
    rng = np.random.default_rng(seed)
    k = 0.5 / relative**2  # of each half: variance of the sum is truth² relative²
    halves = 0.5 * truth * rng.gamma(k, 1.0 / k, (2, RUNS, *truth.shape))
    return halves[0] + halves[1], halves[0] - halves[1]


def _error(found: np.ndarray, truth: np.ndarray, bins: slice | np.ndarray) -> float:
    """Relative root mean square error of bins."""
    return float(np.sqrt((((found - truth) / truth)[:, bins] ** 2).mean()))


def test_plan_of_the_default_grid() -> None:
    plan = make_denoise_plan(EDGES, 0.05, BLUR)
    late = EDGES[plan.first :]
    np.testing.assert_allclose(late[plan.stretches], [0.05, 0.1, 0.2, 0.8])
    np.testing.assert_allclose(late[plan.windows], [0.05, 0.1, 0.2, 0.35, 0.5, 0.65, 0.8])
    assert plan.levels.tolist() == [3, 3, 3] and plan.blurred.tolist() == [2, 1, 0]


@pytest.mark.parametrize("end", [0.03, 0.05, 0.06, 0.11])
def test_plan_of_little(end: float) -> None:
    """Echograms that end before, at, or soon after the first late bin."""
    raw = _decaying(_edges()[: round(end * 1000) + 1] if end <= 0.05 else EDGES[end + 1e-9 > EDGES])
    edges = EDGES[: len(raw) + 1]
    found, plan = _smoothed(raw[None], np.zeros_like(raw)[None], edges)
    assert plan.first <= len(raw) and plan.stretches[-1] == len(raw) - plan.first
    np.testing.assert_allclose(found[0], raw, rtol=1e-6)


def test_without_noise_nothing_changes() -> None:
    """Whatever the echogram is: here one of any shape."""
    raw = np.random.default_rng(1).exponential(1.0, (5, len(EDGES) - 1, BANDS)) * _decaying(EDGES)
    found, _ = _smoothed(raw, np.zeros_like(raw), EDGES)
    np.testing.assert_allclose(found, raw, rtol=2e-6)


@pytest.mark.parametrize("split", [0, 63, 75, 88])
def test_sums_that_are_known_are_kept(split: int) -> None:
    raw, difference = _noisy(_decaying(EDGES), 0.2)
    found, plan = _smoothed(raw, difference, EDGES, split)
    assert not np.allclose(found[:, plan.first :], raw[:, plan.first :], rtol=0.1)
    np.testing.assert_allclose(found[:, : plan.first], raw[:, : plan.first], rtol=1e-7)
    ends = np.union1d(plan.windows + plan.first, [split or plan.first])
    sums = [np.add.reduceat(x, ends[:-1], axis=1) for x in (found, raw)]
    np.testing.assert_allclose(sums[0], sums[1], rtol=1e-6)


@pytest.mark.parametrize("seed", range(8))
def test_any_echogram_stays_finite_and_keeps_sums(seed: int) -> None:
    """Energies that differ by up to e^80 from bin to bin, most of them missing, with any difference and split: sums
    before and after the split."""
    rng = np.random.default_rng(seed)
    spread, filled = [3.0, 20.0, 60.0, 80.0][seed % 4], [0.5, 0.03][seed // 4]
    edges = [EDGES, EVEN, EDGES[:120]][seed % 3]
    shape = (50, len(edges) - 1, BANDS)
    raw = np.exp(rng.uniform(-spread, 0.0, shape)) * (rng.random(shape) < filled)
    split = int(rng.integers(0, len(edges)))
    found, plan = _smoothed(raw, raw * rng.uniform(-1.0, 1.0, shape), edges, split)
    ends = np.unique([plan.first, min(max(split, plan.first), shape[1] - 1)])
    sums = [np.add.reduceat(x, ends, axis=1) for x in (found, raw)]
    np.testing.assert_allclose(sums[0], sums[1], rtol=1e-5, atol=1e-33)
    assert (sums[0][sums[1] == 0.0] == 0.0).all()


def test_what_is_not_a_number_stays_so() -> None:
    raw, difference = _noisy(_decaying(EDGES), 0.4)
    plan = make_denoise_plan(EDGES, 0.05, BLUR)
    for bad in (np.nan, np.inf):
        table = np.zeros((1, 1, *raw.shape[1:2], 9, BANDS), np.float32)
        table[0, :, :, 0] = raw[:1]
        table[0, 0, 100, 0, 2] = bad
        late = difference[None, :1, plan.first :].astype(np.float32)
        unknown = np.zeros((1, 1, 1, BANDS), np.float32)
        noise = Noise(late, unknown, np.zeros(raw.shape[1], np.int64))
        smooth_late(table, noise, np.zeros((1, 1), np.int64), plan)
        assert not np.isfinite(table[0, 0, :, 0, 2]).all()
        assert np.isfinite(table[0, 0, :, 0, [0, 1, 3]]).all()


def _spline_weights(levels: int) -> float:
    """Sum of squared weights of the B3 spline's cascade: what it leaves of the variance of even noise."""
    weights = np.ones(1)
    for level in range(levels):
        spline = np.zeros(4 * 2**level + 1)
        spline[:: 2**level] = np.array([1.0, 4.0, 6.0, 4.0, 1.0]) / 16.0
        weights = np.convolve(weights, spline)
    return float((weights**2).sum())


@pytest.mark.parametrize("relative", [0.1, 0.4, 1.0])
def test_noise_on_a_decay_falls(relative: float) -> None:
    """Bins inside a stretch: less than .65 of the error, never less than the widest spline leaves; and no bias.

    What is judged bin by bin is kept now and then by chance: that is between the two. 1.0: exponential halves.
    """
    truth = _decaying(EVEN)
    raw, difference = _noisy(truth, relative)
    found, plan = _smoothed(raw, difference, EVEN)
    assert plan.levels.tolist() == [3]
    inner = slice(25, 75)
    assert _error(raw, truth, inner) == pytest.approx(relative, rel=0.03)
    assert np.sqrt(_spline_weights(3)) < _error(found, truth, inner) / relative < 0.65
    off = (found / truth - 1.0)[:, inner].mean(axis=(1, 2))
    assert abs(off.mean()) < 4.0 * off.std(ddof=1) / np.sqrt(RUNS)


@pytest.mark.parametrize("period", [2, 4, 5])
def test_flutter_echo_stays(period: int) -> None:
    """Every few bins four times the energy (6 dB), with a noise of .1: no bin's error grows, and no echo
    shrinks."""
    truth = _decaying(EVEN)
    truth[::period] *= 4.0
    raw, difference = _noisy(truth, 0.1)
    found, _ = _smoothed(raw, difference, EVEN)
    for at in range(period):
        bins = np.arange(20 + at, 80, period)
        assert _error(found, truth, bins) < 1.01 * _error(raw, truth, bins)
    ratio = (found / truth)[:, 20:80:period].mean(axis=(1, 2))
    assert abs(ratio.mean() - 1.0) < 4.0 * ratio.std(ddof=1) / np.sqrt(RUNS)


def test_single_echo_stays_where_noise_goes() -> None:
    """A bin ten standard errors high: it loses less than one, and what is far from it is as smooth as without
    it."""
    truth = _decaying(EVEN)
    truth[50] *= 2.0
    raw, difference = _noisy(truth, 0.1)
    found, _ = _smoothed(raw, difference, EVEN)
    assert abs(found[:, 50].mean() / truth[50].mean() - 1.0) < 0.05
    assert _error(found, truth, slice(20, 35)) < 0.7 * _error(raw, truth, slice(20, 35))


def test_coupled_decay_stays() -> None:
    """A slope that is ten times as long, and a room whose sound comes from 0.4 s on: at the bends as well."""
    truth = _decaying(EVEN, 40.0) + 0.01 * _decaying(EVEN, 4.0)
    truth[40:] *= 2.0
    raw, difference = _noisy(truth, 0.05)
    found, _ = _smoothed(raw, difference, EVEN)
    for bins in (slice(8, 20), slice(20, 38), slice(38, 43), slice(43, 80)):
        assert _error(found, truth, bins) < 1.05 * _error(raw, truth, bins)
    assert _error(found, truth, slice(45, 80)) < 0.8 * _error(raw, truth, slice(45, 80))


def test_smoothed_bins_are_unbiased() -> None:
    """z of every late bin of the default grid against the truth, of a decay whose slope is constant."""
    truth = _decaying(EDGES)
    raw, difference = _noisy(truth, 0.2, seed=3)
    found, plan = _smoothed(raw, difference, EDGES)
    late = slice(plan.first, None)
    z = (found.mean(axis=0) - truth)[late] / (found.std(axis=0, ddof=1)[late] / np.sqrt(RUNS))
    rooted = (raw.mean(axis=0) - truth)[late] / (raw.std(axis=0, ddof=1)[late] / np.sqrt(RUNS))
    assert np.abs(rooted).max() < 4.5  # the draws are what they should be
    assert np.abs(z.mean()) < 0.5 and np.abs(z).max() < 5.5


def _levels(energy: np.ndarray) -> np.ndarray:
    """Energy per second of the bins of EDGES, dB."""
    return 10.0 * np.log10(energy / np.diff(EDGES)[:, None])


def test_no_cliffs_where_windows_meet() -> None:
    """A decay of T = .45 s, half of it from deposits of ten times a bin's energy at .35 s, Poisson distributed.

    Across the ends of windows from .35 s on the level falls as the decay does, to within 1.5 dB: in 95 of 100,
    and in 99 of those without a deposit within five bins (a deposit may fill a window's last bin alone). Sums
    stay, but for deposits that would let the decay rise, in 1 of 100.
    """
    truth, rng = _decaying(EDGES, 13.8155 / 0.45), np.random.default_rng(0)
    deposit = 10.0 * truth[np.searchsorted(EDGES, 0.35 - 1e-9)]
    count = rng.poisson(0.25 * truth / deposit, (2, RUNS, *truth.shape))
    halves = 0.25 * truth * rng.gamma(25.0, 1.0 / 25.0, count.shape) + deposit * count
    raw = halves[0] + halves[1]
    found, plan = _smoothed(raw, halves[0] - halves[1], EDGES)
    starts = plan.first + plan.windows[:-1]
    sums = [np.add.reduceat(x, starts, axis=1) for x in (found, raw)]
    np.testing.assert_allclose(sums[0].sum(axis=1), sums[1].sum(axis=1), rtol=1e-5)
    assert (np.abs(sums[0] / sums[1] - 1.0) < 1e-5).mean() > 0.99
    ends = starts[3:]
    assert EDGES[ends] == pytest.approx([0.35, 0.5, 0.65])
    level = _levels(found) - _levels(truth)
    jumps = np.abs(level[:, ends] - level[:, ends - 1])
    alone = np.stack([count.sum(axis=0)[:, e - 5 : e + 5].sum(axis=1) == 0 for e in ends], axis=1)
    assert alone.mean() > 0.5
    assert np.quantile(jumps, 0.95) <= 1.5
    assert np.quantile(jumps[alone], 0.99) <= 1.5


def _rises(found: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """(runs, b) largest rise, dB, of energy in 50 ms over that of the 50 ms before, from .35 s on, beyond that of the
    truth."""
    at = np.searchsorted(EDGES, np.arange(0.35, 0.81, 0.05) - 1e-9)[:-1]
    level, expected = (10.0 * np.log10(np.add.reduceat(x, at, axis=-2)) for x in (found, truth))
    return np.asarray((np.diff(level, axis=1) - np.diff(expected, axis=0)).max(axis=1))


@pytest.mark.parametrize("common", [False, True])
def test_what_few_subpaths_bring_is_no_echo(common: bool) -> None:
    """A decay of T = 1.2 s, half of it from deposits of eight times the energy of a window of 150 ms at its place,
    Poisson distributed, by subpaths of one end, or in `common`, which D does not tell of, but batches do.

    Energy rises by more than 6 dB in 50 ms in less than 1 of 100 echograms, in more than 1 of 10 raw ones. The energy
    of all late bins stays, of each; so its mean over runs is that of the truth, within four standard errors.
    """
    truth, rng = _decaying(EDGES, 13.8155 / 1.2), np.random.default_rng(1)
    plan = make_denoise_plan(EDGES, 0.05, BLUR)
    of_window = truth / np.diff(EDGES)[:, None] * 0.15
    late = (EDGES[:-1] >= 0.3)[:, None]
    chance = np.where(late, 0.5 * truth / (8.0 * of_window), 0.0)
    lucky = 8.0 * of_window * rng.poisson(chance, (RUNS, *truth.shape))
    even = np.where(late, 0.5, 1.0) * truth
    halves = 0.5 * even * rng.gamma(25.0, 1.0 / 25.0, (2, RUNS, *truth.shape))
    raw, difference = halves.sum(axis=0) + lucky, halves[0] - halves[1] + (0.0 if common else lucky)
    window = np.searchsorted([0.3, 0.55], EDGES[:-1] + 1e-9)
    of_time = np.add.reduceat(lucky**2, [0, *np.flatnonzero(np.diff(window)) + 1], axis=1)
    table = np.zeros((1, *raw.shape[:2], 9, BANDS), np.float32)
    table[0, :, :, 0] = raw
    of_ends = difference[None, :, plan.first :].astype(np.float32)
    noise = Noise(of_ends, np.sqrt(of_time)[None].astype(np.float32), window)
    smooth_late(table, noise, np.full((1, RUNS), plan.first), plan)
    found = table[0, :, :, 0].astype(float)
    assert (_rises(raw, truth) > 6.0).mean() > 0.1
    assert (_rises(found, truth) > 6.0).mean() < 0.01
    total = found[:, plan.first :].sum(axis=1)
    np.testing.assert_allclose(total, raw[:, plan.first :].sum(axis=1), rtol=1e-5)
    assert_mean(total, truth[plan.first :].sum(axis=0), "late energy")


@pytest.mark.parametrize("times", [0.3, 1.0, 3.0, 10.0])
def test_one_heavy_deposit_leaves_no_plateau(times: float) -> None:
    """One deposit of so many times a window's energy, in any bin of it, by subpaths of one end alone; T = .45 s.

    Where the levels of a window's neighbours say that sound decays on both sides, its regression line falls at
    least half as steeply as the flatter of both slopes between means.
    """
    truth = _decaying(EDGES, 13.8155 / 0.45)
    plan = make_denoise_plan(EDGES, 0.05, BLUR)
    starts = plan.first + plan.windows
    late = np.arange(starts[2], starts[-2])  # from .2 s on; the last window has one neighbour
    window = np.searchsorted(starts, late, side="right") - 1
    rng = np.random.default_rng(1)
    raw, difference = truth * rng.normal(0.0, 0.1, (2, len(late), *truth.shape))
    raw += truth
    deposit = times * np.add.reduceat(truth, starts[:-1])[window]
    for x in (difference, raw):
        x[np.arange(len(late)), late] += deposit
    level = _levels(_smoothed(raw, difference, EDGES)[0])
    time, centres = 0.5 * (EDGES[1:] + EDGES[:-1]), 0.5 * (EDGES[starts[1:]] + EDGES[starts[:-1]])
    means = 10.0 * np.log10(np.add.reduceat(raw, starts[:-1], axis=1) / np.diff(EDGES[starts])[:, None])
    slopes = np.diff(means, axis=1) / np.diff(centres)[:, None]
    for k, w in enumerate(window.tolist()):
        inside = slice(starts[w], starts[w + 1])
        fitted = np.polyfit(time[inside], level[k, inside], 1)[0]
        flatter = slopes[k, w - 1 : w + 1].max(axis=0)
        assert np.all(flatter < 0.0)
        assert np.all(fitted <= 0.5 * flatter), (k, fitted, flatter)


def test_nothing_arrives_before_the_first_sound() -> None:
    truth = _decaying(EVEN)
    truth[:30] = 0.0
    raw, difference = _noisy(truth, 0.5)
    found, _ = _smoothed(raw, difference, EVEN)
    assert (found[:, :30] == 0.0).all()
    assert not np.allclose(found[:, 30:], raw[:, 30:], rtol=0.1)


def test_who_keeps_raw_bins() -> None:
    """The paper's settings."""
    assert ss.SimulationConfig().denoise is True
    assert ss.load_config(resource("pipelines", "paper.toml")).simulation.denoise is False


# In rooms

POINTS = np.array([[1.0, 1.0, 1.2], [3.0, 2.0, 1.3], [5.0, 2.0, 1.2], [7.9, 3.9, 0.1]])
CONFIG = {"walks": 200, "duration": 0.4, "denoise": True}


@pytest.fixture(scope="module")
def both() -> list[ss.Echograms]:
    """Raw and smoothed echograms of the same subpaths."""
    scene = two_rooms(MIXED, 1)
    return [ss.simulate(scene, POINTS, POINTS, plain(**{**CONFIG, "denoise": s})) for s in (False, True)]


def test_raw_bins_are_those_of_the_walks(both: list[ss.Echograms]) -> None:
    """Without smoothing the tracer's own bins; with it the same before 50 ms, other ones after."""
    raw, smooth = both
    config = plain(**CONFIG)
    model = make_model(two_rooms(MIXED, 1), POINTS, config)
    found = traced(run_techniques(model, POINTS, None), True)
    np.testing.assert_array_equal(raw.energy, found.forward.energy)
    first = int(np.searchsorted(raw.time_edges, 0.05 - 1e-9))
    np.testing.assert_array_equal(raw.energy[:, :, :first], smooth.energy[:, :, :first])
    np.testing.assert_array_equal(raw.relative_error, smooth.relative_error)
    np.testing.assert_array_equal(raw.early.energy, smooth.early.energy)
    np.testing.assert_array_equal(raw.direct_energy, smooth.direct_energy)
    off = ~np.eye(len(POINTS), dtype=bool)
    assert (raw.energy[off][:, first:] != smooth.energy[off][:, first:]).any(axis=(1, 2, 3)).all()


def test_early_and_late_energy_stay(both: list[ss.Echograms]) -> None:
    raw, smooth = (e.energy[..., 0, :].astype(float) for e in both)
    edges = both[0].time_edges
    for i in range(len(POINTS)):
        for j in range(len(POINTS)):
            split = int(np.searchsorted(edges, both[0].direct_length[i, j] / 343.0 + EARLY_S))
            cuts = np.unique([0, split, *np.searchsorted(edges, [0.1 - 1e-9, 0.2 - 1e-9, 0.35 - 1e-9])])
            sums = [np.add.reduceat(e[i, j], cuts, axis=0) for e in (raw, smooth)]
            np.testing.assert_allclose(sums[1], sums[0], rtol=1e-5)


def test_reciprocity_tiles_and_moments(both: list[ss.Echograms]) -> None:
    """To the bit, as of raw bins; and directions stay within the addition theorem's bound."""
    smooth = both[1]
    np.testing.assert_array_equal(smooth.energy[..., 0, :], smooth.energy[..., 0, :].swapaxes(0, 1))
    model = make_model(two_rooms(MIXED, 1), POINTS, plain(**CONFIG))
    forward, backward = simulate_tile(model, POINTS[[3, 0]], POINTS[[1, 2]])
    assert backward is not None
    for i, s in enumerate((3, 0)):
        for j, l in enumerate((1, 2)):
            np.testing.assert_array_equal(forward.energy[i, j], smooth.energy[s, l])
            np.testing.assert_array_equal(backward.energy[j, i], smooth.energy[l, s])
    energy = smooth.energy.astype(float)
    for channels in (slice(1, 4), slice(4, 9)):
        power = (energy[:, :, :, channels] ** 2).sum(axis=3)
        assert np.all(power <= energy[:, :, :, 0] ** 2 * (1.0 + 1e-4) + 1e-20)


@ci_slow
def test_rounds_are_smoothed_once_at_the_end() -> None:
    """The mean of two rounds' bins, smoothed by the mean of their differences."""
    scene = two_rooms(MIXED, 1)
    more = {**CONFIG, "walks": 160, "target_error": 1e-6, "max_walks": 320}
    raw = ss.simulate(scene, POINTS[:2], POINTS[2:], plain(**{**more, "denoise": False}))
    smooth = ss.simulate(scene, POINTS[:2], POINTS[2:], plain(**more))
    edges = raw.time_edges
    first = int(np.searchsorted(edges, 0.05 - 1e-9))
    np.testing.assert_array_equal(raw.energy[:, :, :first], smooth.energy[:, :, :first])
    assert not np.array_equal(raw.energy, smooth.energy)
    cuts = np.searchsorted(edges, [0.1 - 1e-9, 0.2 - 1e-9, 0.35 - 1e-9])
    sums = [np.add.reduceat(e.energy[..., 0, :].astype(float), cuts, axis=2) for e in (raw, smooth)]
    np.testing.assert_allclose(sums[1], sums[0], rtol=1e-5)
    model = make_model(scene, POINTS, plain(**more))
    alone = simulate_pairs(model, POINTS[:1], POINTS[3:])[0]
    np.testing.assert_array_equal(alone.energy[0, 0], smooth.energy[0, 1])


@pytest.mark.slow
def test_error_against_image_sources_does_not_rise(monkeypatch: pytest.MonkeyPatch) -> None:
    """10 ms from 50 to 250 ms of a mirror shoebox, where structure is as strong as noise: root mean square
    error."""
    delay, energy, *_ = _image_sources(SIZE, SOURCE, LISTENER, 0.2, 0.3)
    expected = np.histogram(delay, np.arange(0.05, 0.2501, 0.01), weights=energy)[0]
    scene, few = box(SIZE, table(0.2, 0.0)), {"walks": 1000, "specular": {"ratio": 16}, "duration": 0.26}

    monkeypatch.setattr(detector, "GROWTH", detector.Growth(0.1, 0.01, 0.25))

    def error(smooth: bool) -> float:
        config = plain(**few, denoise=smooth)
        runs = [
            ss.simulate(scene, [SOURCE], [LISTENER], config, k)[0, 0].histogram(0.01)[0]
            for k in range(8)
        ]
        return float(np.sqrt(((np.array(runs)[:, 5:25] / expected - 1.0) ** 2).mean()))

    raw = error(False)
    assert 0.05 < raw < 0.12  # there is noise to lose
    assert error(True) < 1.05 * raw
