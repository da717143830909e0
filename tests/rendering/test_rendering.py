"""Echogram to ambisonics to two ears."""

from itertools import pairwise, product

import numpy as np
import pytest
from scipy.signal import butter, sosfiltfilt
from scipy.special import sph_harm_y

import soundspaces_sim as ss
from soundspaces_sim.core.numerics.axes import head_matrix, rotation_matrix, spherical_harmonics
from soundspaces_sim.core.numerics.bands import DEFAULT_BANDS
from soundspaces_sim.echogram.echogram import Arrival, Arrivals
from soundspaces_sim.echogram.filters import band_shares, white_noise
from soundspaces_sim.rendering.ambisonics import ambisonic_rirs
from soundspaces_sim.rendering.binaural import binaural_rirs
from soundspaces_sim.rendering.decoder import Method, decoder_filters, equalised_spectra
from soundspaces_sim.rendering.hrtf import HrtfError, load_hrtf
from soundspaces_sim.rendering.seed_paper import paper_rir
from soundspaces_sim.transport.tables import harmonics
from tests.conftest import energy
from tests.marks import few
from tests.rooms import box, plain, table
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
        harmonics.py_func(*d[i], out)
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
    got = rotation_matrix(head_matrix(37.0)) @ spherical_harmonics(d).T
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
    use = (f > 50.0) & (f < min(18000.0, (0.41 if rate > 8000 else 0.34) * rate))
    assert np.all(np.abs(20.0 * np.log10(np.abs(spectrum[use]) / np.sqrt(level))) < 0.5)
    slope = np.polyfit(2 * np.pi * f[use], np.unwrap(np.angle(spectrum[use])), 1)[0]
    assert -slope == pytest.approx(delay, abs=2e-6)
    intensity = (rir[0] * rir[[3, 1, 2]]).sum(axis=1)
    np.testing.assert_allclose(intensity / np.linalg.norm(intensity), direction, atol=1e-3)
    before = rir[0, : int((delay - 0.001) * rate)]
    assert np.abs(before).max() < 1e-3 * np.abs(rir[0]).max()


@pytest.mark.parametrize("rate", [16000, 44100])
def test_no_arrival_rings_before_its_time(rate: int) -> None:
    """Minimum phase: -60 dB from 1 ms before on, however unequal the bands; band energies within 0.5 dB."""
    energies = np.array([1.0, 0.02, 0.5, 0.001])
    rir = ss.ambisonic_rir(
        _echogram(np.zeros((400, 9, 4)), Arrival(0.1, energies, np.array([1.0, 0, 0]))), rate
    )
    assert np.abs(rir[0, : int(0.099 * rate)]).max() < 1e-3 * np.abs(rir[0]).max()
    f = np.fft.rfftfreq(rir.shape[1], 1.0 / rate)
    power = np.abs(np.fft.rfft(rir[0].astype(float))) ** 2
    for b, (low, high) in enumerate(pairwise(DEFAULT_BANDS)):
        use = (f > max(low * 1.2, 50.0)) & (f < min(high / 1.2, 0.4 * rate))
        assert 10 * np.log10(power[use].mean() / energies[b]) == pytest.approx(0.0, abs=0.5)


@pytest.mark.parametrize(
    ("rate", "band"),
    few(product((16000, 44100), range(4)), (16000, 0), (16000, 3), (44100, 1)),
)
def test_a_lone_arrival_stays_in_its_band(rate: int, band: int) -> None:
    """Leak at most -20 dB, as a discrete arrival and as the energy of one 1 ms bin (mean of 100 seeds)."""
    one = np.eye(4)[band]
    table = np.zeros((1000, 9, 4), np.float32)
    table[300, 0] = one
    lone = [ss.ambisonic_rir(_echogram(0 * table, Arrival(0.3, one, np.array([1.0, 0, 0]))), rate)[0]]
    noise = [ss.ambisonic_rir(_echogram(table), rate, seed)[0] for seed in range(100)]
    f = np.fft.rfftfreq(rate, 1.0 / rate)
    inside = (f >= DEFAULT_BANDS[band]) & (f < DEFAULT_BANDS[band + 1])
    for responses in (lone, noise):
        power = np.mean([np.abs(np.fft.rfft(h.astype(float))) ** 2 for h in responses], axis=0)
        assert 10 * np.log10(power[~inside].sum() / power.sum()) <= -20.0


def test_noise_is_white_and_shares_add_up() -> None:
    """Unit variance, equal magnitudes; shares sum to one below the highest edge and to zero above."""
    noise = white_noise().astype(float)
    assert noise.var() == pytest.approx(1.0, abs=1e-5)
    np.testing.assert_allclose(np.abs(np.fft.rfft(noise)[1:-1]), np.sqrt(len(noise)), rtol=1e-4)
    f = np.linspace(0.0, 22050.0, 5000)
    total = band_shares(DEFAULT_BANDS, f, 44100.0).sum(axis=0)
    np.testing.assert_allclose(total[f < 19000.0], 1.0, atol=1e-12)
    np.testing.assert_allclose(total[f > 21000.0], 0.0, atol=1e-12)
    np.testing.assert_allclose(
        band_shares(DEFAULT_BANDS, f[f < 4000], 8000.0).sum(axis=0), 1.0, atol=1e-12
    )


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


def test_energy_per_order_and_channel() -> None:
    """One arrival, diffuse sound, and two arrivals in a bin, of which order 1 is exact and order 2 as a sum.

    Two arrivals of energies 1/4 and 3/4: covariance sum_i w_i Y(d_i) Y(d_i)^T.
    """
    a, b = np.array([0.36, 0.48, 0.8]), np.array([0.6, -0.8, 0.0])
    w = np.array([0.25, 0.75])[:, None]
    both = spherical_harmonics(np.stack([a, b]))
    cases = (
        (np.eye(9)[0], np.diag([1.0] + [1 / 3] * 3 + [1 / 5] * 5)),
        (both[0], np.outer(both[0], both[0])),
        ((w * both).sum(axis=0), (w * both).T @ both),
    )
    for moments, covariance in cases:
        table = np.broadcast_to(moments[None, :, None], (400, 9, 4)).astype(np.float32)
        rirs = [ss.ambisonic_rir(_echogram(table), 16000, s).astype(float) for s in range(60)]
        got = np.stack([r @ r.T for r in rirs])
        got /= got[:, 0, 0].mean()
        for c, d in ((0, 0), (1, 1), (2, 2), (3, 3), (0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)):
            z = z_scores(got[:, c, d], covariance[c, d])
            assert np.abs(z) < 4.5, (c, d, z)
        order2 = np.trace(got[:, 4:, 4:], axis1=1, axis2=2)
        assert np.abs(z_scores(order2, np.trace(covariance[4:, 4:]))) < 4.5


def test_late_sound_has_the_interaural_coherence_of_a_diffuse_field() -> None:
    """Third octaves from 200 Hz to 8 kHz, within 0.1 rms of the measured set's diffuse-field curve."""
    rate = 44100
    table = np.zeros((500, 9, 4), np.float32)
    table[:, 0] = 1.0
    cross: np.ndarray = np.zeros(3)[:, None]
    for seed in range(20):
        ears = ss.binaural_rir(ss.ambisonic_rir(_echogram(table), rate, seed), rate).astype(float)
        left, right = np.fft.rfft(ears, axis=1)
        cross = cross + np.stack([np.abs(left) ** 2, np.abs(right) ** 2, (left * right.conj()).real])
    hrtf = load_hrtf()
    spectra = equalised_spectra(hrtf)
    field = np.einsum("pef,p,pgf->egf", spectra, hrtf.weights, spectra.conj()).real
    f, f0 = np.fft.rfftfreq(ears.shape[1], 1 / rate), np.fft.rfftfreq(2048, 1 / hrtf.rate)
    error = []
    for center in 1000.0 * 2.0 ** (np.arange(-7, 10) / 3):
        use, use0 = (np.abs(np.log2(np.maximum(x, 1e-9) / center)) < 1 / 6 for x in (f, f0))
        ll, rr, lr = cross[:, use].sum(axis=1)
        wanted = field[0, 1, use0].sum() / np.sqrt(field[0, 0, use0].sum() * field[1, 1, use0].sum())
        error.append(lr / np.sqrt(ll * rr) - wanted)
    assert np.sqrt(np.mean(np.square(error))) < 0.1, error


def test_rendered_levels_of_a_room() -> None:
    """Of a simulated echogram: per band and 50 ms within 0.5 dB, in the mean, down to -50 dB."""
    rate, window = 16000, 0.05
    scene = box((6.0, 5.0, 2.7), table(0.2, 0.5))
    echogram = ss.simulate(scene, [1.5, 2.0, 1.2], [4.3, 3.1, 1.6], plain(walks=500))[0, 0]
    n = int(echogram.time_edges[-1] / window)
    want = echogram.histogram(window)[:3, :n]
    got = np.zeros_like(want)
    for seed in range(60):
        response = ss.ambisonic_rir(echogram, rate, seed)[0].astype(float)
        size = 2 * len(response)
        shares = band_shares(DEFAULT_BANDS, np.fft.rfftfreq(size, 1 / rate), rate)[:3]
        parts = np.fft.irfft(np.fft.rfft(response, size) * np.sqrt(shares), size)[
            :, : int(n * window * rate)
        ]
        width = np.array([(share**2).mean() for share in shares])[:, None]  # of noise cut twice
        got += energy(parts.reshape(3, n, -1)) / width / 60
    used = want > 1e-5 * want.sum(axis=1, keepdims=True)
    used[:, :2] = False  # the direct sound is cut once: band_shares of a delta are not those of noise
    assert used.sum() > 6
    difference = 10 * np.log10(got[used] / want[used])
    assert abs(difference.mean()) < 0.5 and np.abs(difference).max() < 1.5, difference


def test_many_at_once_are_the_same(echogram: ss.Echogram) -> None:
    together = ambisonic_rirs([echogram] * 5, 16000, seeds=[3, 1, 4, 1, 5], workers=2)
    for rir, seed in zip(together, [3, 1, 4, 1, 5], strict=True):
        np.testing.assert_array_equal(rir, ss.ambisonic_rir(echogram, 16000, seed))
    with pytest.raises(ss.ConfigError, match="one per echogram"):
        ambisonic_rirs([echogram], 16000, seeds=[1, 2])
    headings = [(0.0, 0.0, 0.0), (90.0, 0.0, 0.0), (123.0, 20.0, -10.0)]
    for ears, (heading, pitch, roll) in zip(
        binaural_rirs(together[0], 16000, headings), headings, strict=True
    ):
        alone = ss.binaural_rir(together[0], 16000, heading, pitch_deg=pitch, roll_deg=roll)
        np.testing.assert_array_equal(ears, alone)


def test_the_papers_rendering_is_one_noise_times_coefficients(echogram: ss.Echogram) -> None:
    """Channels are W times the moments of each bin, in all bands alike; energies as in the echogram."""
    moments = np.array([1.0, 0.5, 0.0, -0.2, 0.1, 0.0, 0.3, 0.0, 0.0])
    table = (np.exp(-np.arange(300) / 60.0)[:, None, None] * moments[None, :, None] * np.ones(4)).astype(
        np.float32
    )
    rir = paper_rir(_echogram(table), 44100, 7)
    np.testing.assert_allclose(rir, moments[:, None] * rir[:1], atol=1e-6)
    total = [energy(paper_rir(_echogram(table), 44100, s)[0]) for s in range(40)]
    covered = band_shares(DEFAULT_BANDS, np.linspace(0, 22050, 10001), 44100.0).sum(axis=0).mean()
    assert np.abs(z_scores(np.array(total), covered * table[:, 0, 0].sum())) < 4.5
    direct = paper_rir(echogram, 16000)
    assert direct.shape == ss.ambisonic_rir(echogram, 16000).shape and direct.dtype == np.float32


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
    left = ss.binaural_rir(_impulse([0, 1, 0]), 44100)
    right = ss.binaural_rir(_impulse([0, -1, 0]), 44100)
    assert energy(left)[0] > 4.0 * energy(left)[1]
    np.testing.assert_allclose(left, right[::-1], atol=1e-6)
    facing = ss.binaural_rir(_impulse([0, 1, 0]), 44100, heading_deg=90.0)
    np.testing.assert_allclose(facing, ss.binaural_rir(_impulse([1, 0, 0]), 44100), atol=1e-6)


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
        error.append(
            _itd_us(*ss.binaural_rir(_impulse(hrtf.directions[i]), 44100)) - _itd_us(*hrtf.ir[i])
        )
    assert np.mean(np.abs(error)) <= 65.0 and np.max(np.abs(error)) <= 145.0


@pytest.mark.parametrize("decoder", ["aligned", "magls"])
def test_ild_follows_the_measured_head(decoder: Method) -> None:
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
                for ears in (
                    ss.binaural_rir(_impulse(hrtf.directions[i]), 44100, decoder=decoder),
                    hrtf.ir[i],
                )
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
        ss.binaural_rir(np.zeros((4, 100)), 44100)
    with pytest.raises(ss.ConfigError, match="decoder"):
        ss.binaural_rir(np.zeros((9, 100)), 44100, decoder="best")  # type: ignore[arg-type]


def test_the_rate_of_a_response_is_asked_for(echogram: ss.Echogram) -> None:
    """A response at 16 kHz is not taken to be at 44.1: there is no rate that an array could mean."""
    rir = ss.ambisonic_rir(echogram, 16000)
    with pytest.raises(
        ss.ConfigError, match="rate: expected the sampling rate of `rir` in Hz, got none"
    ):
        ss.binaural_rir(rir)
    with pytest.raises(
        ss.ConfigError, match="rate: expected the sampling rate of `signal` in Hz, got none"
    ):
        ss.binaural_moving(rir, [(0.0, 0.0, 0.0)])
    for bad in (0, 4000, float("nan")):
        with pytest.raises(ss.ConfigError, match="rate: expected 8000 to 192000 Hz"):
            ss.binaural_rir(rir, bad)  # type: ignore[arg-type]
    np.testing.assert_array_equal(
        ss.binaural_rir(rir, 16000), binaural_rirs(rir, 16000, [(0.0, 0.0, 0.0)])[0]
    )


def test_histogram_keeps_energy(echogram: ss.Echogram) -> None:
    total = echogram.energy[:, 0].sum(axis=0, dtype=float) + sum(a.energy for a in echogram.arrivals)
    for width in (0.001, 0.0037, 0.01, 10.0):
        h = echogram.histogram(width)
        assert h.dtype == np.float64
        np.testing.assert_allclose(h.sum(axis=1), total, rtol=1e-6)
