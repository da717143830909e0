"""Echogram to ambisonics to two ears."""

from itertools import pairwise

import numpy as np
import pytest
from scipy.signal import butter, sosfiltfilt
from scipy.special import sph_harm_y

import soundspaces_sim as ss
from soundspaces_sim.ambisonics import spherical_harmonics
from soundspaces_sim.bands import DEFAULT_BANDS
from soundspaces_sim.binaural import decoder_filters, equalised_spectra
from soundspaces_sim.echogram import Arrival, Arrivals
from soundspaces_sim.filters import band_shares, noise_table
from soundspaces_sim.hrtf import HrtfError, load_hrtf
from soundspaces_sim.soundfield import rotate
from soundspaces_sim.transport.deposit import harmonics
from tests.conftest import energy
from tests.stats import z_scores

NONE = Arrivals(np.empty(0), np.empty((0, 4)), np.empty((0, 3)), np.empty((0, 2), int))


def _echogram(table: np.ndarray, direct: Arrival | None = None, width: float = 0.001) -> ss.Echogram:
    edges = np.arange(len(table) + 1) * width
    return ss.Echogram(DEFAULT_BANDS, edges, table, direct, NONE, np.zeros((2, 4)), True)


def _random_directions(n: int) -> np.ndarray:
    d = np.random.default_rng(1).normal(size=(n, 3))
    return np.asarray(d / np.linalg.norm(d, axis=1, keepdims=True))


def test_harmonics_against_scipy() -> None:
    """Real SH from complex ones: SN3D = N3D / sqrt(2 n + 1), without the Condon-Shortley sign."""
    d = _random_directions(50)
    theta, phi = np.arccos(d[:, 2]), np.arctan2(d[:, 1], d[:, 0])
    ours = spherical_harmonics(d)
    out = np.empty(9)
    for n in range(3):
        for m in range(-n, n + 1):
            y = sph_harm_y(n, abs(m), theta, phi) * (-1) ** m * np.sqrt(4 * np.pi / (2 * n + 1))
            real = y.real if m == 0 else np.sqrt(2.0) * (y.real if m > 0 else y.imag)
            np.testing.assert_allclose(ours[:, n * n + n + m], real, atol=1e-12)
    for i in range(50):
        harmonics(*d[i], out)
        np.testing.assert_allclose(out, ours[i], atol=1e-12)


@pytest.mark.parametrize(
    ("direction", "expected"),
    [
        ([1, 0, 0], [1, 0, 0, 1, 0, 0, -0.5, 0, 0.8660]),
        ([0, 1, 0], [1, 1, 0, 0, 0, 0, -0.5, 0, -0.8660]),
        ([0, 0, 1], [1, 0, 1, 0, 0, 0, 1, 0, 0]),
        ([np.cos(np.pi / 6), 0.5, 0], [1, 0.5, 0, 0.8660, 0.75, 0, -0.5, 0, 0.4330]),
    ],
)
def test_reference_values(direction: list[float], expected: list[float]) -> None:
    """AmbiX reference directions (design/rendering.md)."""
    np.testing.assert_allclose(spherical_harmonics(direction), expected, atol=1e-4)


def test_rotation_moves_sources_clockwise_by_the_heading() -> None:
    d = _random_directions(20)
    turn = np.deg2rad(37.0)
    turned = np.stack([
        np.cos(turn) * d[:, 0] + np.sin(turn) * d[:, 1], np.cos(turn) * d[:, 1] - np.sin(turn) * d[:, 0],
        d[:, 2],
    ], axis=1)  # fmt: skip
    got = rotate(spherical_harmonics(d).T, 37.0)
    np.testing.assert_allclose(got, spherical_harmonics(turned).T, atol=1e-12)


@pytest.mark.parametrize("rate", [8000, 16000, 44100, 48000])
def test_direct_sound_is_a_clean_delta(rate: int) -> None:
    """Equal bands: amplitude sqrt(E), flat, at the true fractional delay, from the right direction."""
    level, delay = 1.0 / (4.0 * np.pi * 9.0), 0.0123456
    direction = np.array([0.6, -0.48, 0.64])
    rir = ss.ambisonic_rir(
        _echogram(np.zeros((50, 9, 4)), Arrival(delay, np.full(4, level), direction)), rate
    )
    f = np.fft.rfftfreq(rir.shape[1], 1.0 / rate)
    spectrum = np.fft.rfft(rir[0].astype(float))
    use = (f > 50.0) & (f < 0.41 * rate)
    assert np.all(np.abs(20.0 * np.log10(np.abs(spectrum[use]) / np.sqrt(level))) < 0.5)
    slope = np.polyfit(2 * np.pi * f[use], np.unwrap(np.angle(spectrum[use])), 1)[0]
    assert -slope == pytest.approx(delay, abs=2e-6)
    intensity = (rir[0] * rir[[3, 1, 2]]).sum(axis=1)
    np.testing.assert_allclose(intensity / np.linalg.norm(intensity), direction, atol=1e-3)
    before = rir[0, : int(delay * rate - max(0.001 * rate, 33))]
    assert np.abs(before).max(initial=0.0) < 1e-3 * np.abs(rir[0]).max()


def test_noise_bank_is_white_and_splits_energy_by_bandwidth() -> None:
    """Power-complementary: band b has variance (its share of the spectrum), the sum has variance 1."""
    noise = noise_table(DEFAULT_BANDS, 44100).astype(float)
    f = np.fft.rfftfreq(1 << 19)
    shares = band_shares(DEFAULT_BANDS, f * 44100.0, 44100.0)
    np.testing.assert_allclose(shares.sum(axis=0), 1.0, atol=1e-12)
    np.testing.assert_allclose((noise**2).mean(axis=1), shares.mean(axis=1), rtol=2e-3)


@pytest.mark.parametrize("rate", [16000, 44100])
def test_band_energies_are_preserved(rate: int) -> None:
    """Rendered energy per band and 50 ms window is the echogram's, within 0.5 dB on average.

    Measured well inside each band (clear of the crossovers), as a share of the bins that it covers.
    """
    decay = np.exp(-np.arange(300) / np.array([[80.0], [60.0], [50.0], [40.0]])).T
    table = np.zeros((300, 9, 4))
    table[:, 0] = decay * [1.0, 0.3, 2.0, 0.5]
    f = np.fft.rfftfreq(rate * 3 // 10, 1.0 / rate)
    inner = [(f > lo * 1.2) & (f < min(hi / 1.2, 0.45 * rate))
             for lo, hi in pairwise(DEFAULT_BANDS) if lo < rate / 2]  # fmt: skip
    got = np.zeros((len(inner), 4))
    for seed in range(80):
        spectrum = np.fft.rfft(ss.ambisonic_rir(_echogram(table), rate, seed)[0].astype(float))
        for b, use in enumerate(inner):
            part = np.fft.irfft(spectrum * use, rate * 3 // 10)
            got[b] += [
                energy(part[int(t * rate) : int((t + 0.05) * rate)]) / 80 for t in (0.05, 0.1, 0.15, 0.2)
            ]
    share = np.array([use.mean() for use in inner])[:, None]
    want = np.stack([table[i : i + 50, 0].sum(axis=0) for i in (50, 100, 150, 200)], axis=1)[
        : len(inner)
    ]
    assert np.all(np.abs(10 * np.log10(got / (want * share))) < 0.5)


def test_energy_per_order_of_diffuse_and_directed_sound() -> None:
    """Each order carries the energy of W, spread over its channels, whatever the moments are."""
    direction = np.array([0.36, 0.48, 0.8])
    for moments, expected in (
        (np.eye(9)[0], np.array([1.0] + [1 / 3] * 3 + [1 / 5] * 5)),
        (spherical_harmonics(direction), spherical_harmonics(direction) ** 2),
    ):
        table = np.broadcast_to(moments[None, :, None], (400, 9, 4))
        got = np.stack([energy(ss.ambisonic_rir(_echogram(table), 16000, s)) for s in range(40)])
        z = z_scores(got / got[:, :1].mean(), expected)
        assert np.all(np.abs(z[expected > 1e-6]) < 4.5), z


def test_same_seed_same_sound_and_another_seed_another(echogram: ss.Echogram) -> None:
    a, b, c = (ss.ambisonic_rir(echogram, 16000, s) for s in (5, 5, 6))
    np.testing.assert_array_equal(a, b)
    assert a.dtype == np.float32 and not np.array_equal(a, c)


@pytest.mark.parametrize("rate", [0, 4000, 1_000_000])
def test_bad_rate(echogram: ss.Echogram, rate: int) -> None:
    with pytest.raises(ss.ConfigError, match="rate"):
        ss.ambisonic_rir(echogram, rate)


def _impulse(direction: list[float] | np.ndarray) -> np.ndarray:
    field = np.zeros((9, 800), np.float32)
    field[:, 400] = spherical_harmonics(direction)
    return field


def _itd_us(left: np.ndarray, right: np.ndarray, rate: float = 44100.0) -> float:
    """Cross-correlation below 1.5 kHz; positive: the left ear leads."""
    sos = butter(4, 1500.0, fs=rate, output="sos")
    a, b = (np.fft.rfft(sosfiltfilt(sos, x), 4096) for x in (left, right))
    c = np.roll(np.fft.irfft(b * a.conj(), 65536), 32768)
    return float((c.argmax() - 32768) / 16 / rate * 1e6)


def test_left_is_left_and_symmetric() -> None:
    left = ss.binaural_rir(_impulse([0, 1, 0]))
    right = ss.binaural_rir(_impulse([0, -1, 0]))
    assert energy(left)[0] > 4.0 * energy(left)[1]
    np.testing.assert_allclose(left, right[::-1], atol=1e-6)
    facing = ss.binaural_rir(_impulse([0, 1, 0]), heading_deg=90.0)
    np.testing.assert_allclose(facing, ss.binaural_rir(_impulse([1, 0, 0])), atol=1e-6)


@pytest.mark.parametrize("rate", [16000, 44100, 48000])
def test_onset_stays_where_it_is(rate: int) -> None:
    ears = ss.binaural_rir(_impulse([1, 0, 0]), rate)
    assert abs(int(np.abs(ears[0]).argmax()) - 400) < 0.0006 * rate


def test_itd_follows_the_measured_head() -> None:
    """Targets of design/rendering.md: mean |error| <= 65 us, max <= 145 us over the horizontal plane."""
    hrtf = load_hrtf()
    error = []
    for azimuth in np.deg2rad(np.arange(0, 360, 5)):
        i = int((hrtf.directions @ [np.cos(azimuth), np.sin(azimuth), 0.0]).argmax())
        error.append(_itd_us(*ss.binaural_rir(_impulse(hrtf.directions[i]))) - _itd_us(*hrtf.ir[i]))
    assert np.mean(np.abs(error)) <= 65.0 and np.max(np.abs(error)) <= 145.0


def test_ild_follows_the_measured_head() -> None:
    """Targets of design/rendering.md: mean |error| of band levels over 72 horizontal azimuths."""
    hrtf = load_hrtf()
    f = np.fft.rfftfreq(2048, 1.0 / hrtf.rate)
    for low, high, target in ((200.0, 1500.0, 1.2), (1500.0, 5000.0, 2.0), (5000.0, 16000.0, 5.5)):
        use = (f >= low) & (f < high)
        error = []
        for azimuth in np.deg2rad(np.arange(0, 360, 5)):
            i = int((hrtf.directions @ [np.cos(azimuth), np.sin(azimuth), 0.0]).argmax())
            power = [
                (np.abs(np.fft.rfft(ears, 2048)[:, use]) ** 2).sum(axis=1)
                for ears in (ss.binaural_rir(_impulse(hrtf.directions[i])), hrtf.ir[i])
            ]
            decoded, measured = (10.0 * np.log10(left / right) for left, right in power)
            error.append(abs(decoded - measured))
        assert np.mean(error) <= target, (low, np.mean(error))


def test_diffuse_field_covariance_is_that_of_the_set() -> None:
    """The covariance of the two ears in a diffuse field is that of the measured set."""
    hrtf = load_hrtf()
    target = equalised_spectra(hrtf)
    wanted = np.einsum("pef,p,pgf->feg", target, hrtf.weights, target.conj())
    filters, _ = decoder_filters(44100)
    decoder = np.fft.rfft(filters.astype(float), 2048, axis=2)
    ears = np.einsum("ecf,pc->pef", decoder, spherical_harmonics(hrtf.directions))
    got = np.einsum("pef,p,pgf->feg", ears, hrtf.weights, ears.conj())
    f = np.fft.rfftfreq(2048, 1.0 / hrtf.rate)
    use = (f > 100.0) & (f < 16000.0)
    scale = np.trace(wanted[use], axis1=1, axis2=2).real / 2.0
    error = np.abs(got[use] - wanted[use]).max(axis=(1, 2)) / scale
    assert error.mean() < 0.02, error.mean()  # an exact design, cut to 512 taps


def test_equalised_set_is_flat_in_a_diffuse_field() -> None:
    hrtf = load_hrtf()
    power = np.einsum("p,pef->f", hrtf.weights, np.abs(equalised_spectra(hrtf)) ** 2) / 2.0
    f = np.fft.rfftfreq(2048, 1.0 / hrtf.rate)
    assert np.all(np.abs(10 * np.log10(power[(f > 60) & (f < 16000)])) < 3.0)  # third-octave smoothing


def test_bad_hrtf_and_bad_field() -> None:
    with pytest.raises(HrtfError, match="nowhere"):
        load_hrtf("nowhere.sofa")
    with pytest.raises(ss.ConfigError, match=r"\(9, n\)"):
        ss.binaural_rir(np.zeros((4, 100)))


def test_histogram_keeps_energy(echogram: ss.Echogram) -> None:
    total = echogram.energy[:, 0].sum(axis=0, dtype=float) + sum(a.energy for a in echogram.arrivals)
    for width in (0.001, 0.0037, 0.01, 10.0):
        h = echogram.histogram(width)
        assert h.dtype == np.float64
        np.testing.assert_allclose(h.sum(axis=1), total, rtol=1e-6)
