"""Room parameters whose values are known in closed form, and their error bars."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

import numpy as np
import pytest
import soundspaces_parameters
from soundspaces_parameters import decay, speech, strength
from soundspaces_parameters.evaluate import spread
from soundspaces_parameters.interaural import EarSpectra, correlation, windows_of
from soundspaces_parameters.office import office_parameters
from soundspaces_parameters.registry import PARAMETERS
from soundspaces_parameters.response import Response, response_of

import soundspaces_sim as ss
from soundspaces_sim.core.numerics.axes import CHANNELS, spherical_harmonics
from soundspaces_sim.core.numerics.bands import DEFAULT_BANDS, fractional_octaves, nominal
from soundspaces_sim.echogram.echogram import Arrival, Arrivals
from soundspaces_sim.echogram.measures import BIN_S, energy_ratios

OCTAVES = tuple(fractional_octaves(1, 63.0, 8000.0)[0].tolist())
FRONT, LEFT, UP = np.eye(3)


def echogram(
    energy: np.ndarray,
    bands: tuple[float, ...] = OCTAVES,
    bin_s: float = 0.001,
    arrivals: tuple[tuple[float, np.ndarray, float], ...] = (),
    direct: tuple[float, np.ndarray, float] | None = (0.0, FRONT, 0.0),
    error: float = 0.0,
) -> ss.Echogram:
    """Diffuse `energy` (n,) or (n, b) in bins of `bin_s`; arrivals (s, direction, energy) in every band."""
    count = len(bands) - 1
    table = np.zeros((len(energy), CHANNELS, count), np.float32)
    table[:, 0] = np.reshape(energy, (len(energy), -1))
    early = Arrivals(
        np.array([a[0] for a in arrivals]),
        np.array([[a[2]] * count for a in arrivals]).reshape(-1, count),
        np.array([a[1] for a in arrivals]).reshape(-1, 3),
        np.full((len(arrivals), 2), -1),
    )
    first = None if direct is None else Arrival(direct[0], np.full(count, direct[2]), direct[1])
    edges = np.arange(len(energy) + 1) * bin_s
    return ss.Echogram(bands, edges, table, first, early, np.full((2, count), error), direct is not None)


def exponential(reverb: float, seconds: float = 4.0, bin_s: float = 0.001) -> np.ndarray:
    """(n,) energies per bin of a decay of one joule in all."""
    at = np.exp(-6.0 * np.log(10.0) / reverb * np.arange(round(seconds / bin_s) + 1) * bin_s)
    return np.asarray(at[:-1] - at[1:])


def response(found: ss.Echogram, towards: np.ndarray | None = FRONT, halves: bool = False) -> Response:
    return response_of(found, found, towards, halves)


def parameter(name: str, found: ss.Echogram, **settings: object) -> np.ndarray:
    """(K,) or (1,) values in octaves."""
    return np.asarray(soundspaces_parameters.room_parameters(found, name, **settings)[name][0])  # type: ignore[arg-type]


def test_every_parameter_of_an_exponential_decay() -> None:
    """T = 1 s, one joule in all: every parameter in closed form, of ISO 3382-1's definitions."""
    reverb, k = 1.0, 6.0 * np.log(10.0)
    found = soundspaces_parameters.room_parameters(echogram(exponential(reverb)))
    early, of_joule = 1.0 - np.exp(-0.08 * k), 4.0 * np.pi * 100.0
    side = np.exp(-0.005 * k) - np.exp(-0.08 * k)
    expected = {
        "t20": reverb, "t30": reverb, "edt": reverb, "curvature": 0.0, "nonlinearity": 0.0,
        "c50": 10 * np.log10(np.exp(0.05 * k) - 1.0), "c80": 10 * np.log10(np.exp(0.08 * k) - 1.0),
        "d50": 1.0 - np.exp(-0.05 * k), "ts": 1.0 / k, "drr": 10 * np.log10(np.exp(0.0025 * k) - 1.0),
        "g": 10 * np.log10(of_joule), "g_early": 10 * np.log10(of_joule * early),
        "g_late": 10 * np.log10(of_joule * (1.0 - early)), "lj": 10 * np.log10(of_joule * (1.0 - early) / 3.0),
        "lf": side / 3.0 / early, "lfc": side / 2.0 / early,
    }  # fmt: skip
    for name, value in expected.items():
        scale = 1e-3 if name != "drr" else 0.15  # of a window of 2.5 bins
        np.testing.assert_allclose(found[name], value, rtol=2e-3, atol=scale, err_msg=name)
    assert set(PARAMETERS) - set(expected) == {"iacc_early", "iacc_late", "iacc", "mti", "sti"}


@pytest.mark.parametrize("reverb", [0.3, 1.0, 2.5])
@pytest.mark.parametrize("snr_db", [None, 0.0, 12.0])
def test_speech_transmission_of_an_exponential_decay(reverb: float, snr_db: float | None) -> None:
    """m(F) = 1 / sqrt(1 + (2 pi F T / 13.8)²) / (1 + 10^(-SNR / 10)) (Houtgast, Steeneken and Plomp 1980), at a
    level at which neither masking nor the threshold counts for much: exactly then, by the definition of the
    index."""
    f = np.array([0.63, 0.8, 1, 1.25, 1.6, 2, 2.5, 3.15, 4, 5, 6.3, 8, 10, 12.5])
    m = 1.0 / np.sqrt(1.0 + (2.0 * np.pi * f * reverb / (6.0 * np.log(10.0))) ** 2)
    got = speech.modulation_transfer(exponential(reverb, 6.0)[None], 0.001)[0]
    np.testing.assert_allclose(got, m, rtol=1e-3)
    if snr_db is not None:
        m = m / (1.0 + 10.0 ** (-snr_db / 10.0))
    index = np.mean((np.clip(10.0 * np.log10(m / (1.0 - m)), -15.0, 15.0) + 15.0) / 30.0)
    noisy = got if snr_db is None else got / (1.0 + 10.0 ** (-snr_db / 10.0))
    np.testing.assert_allclose(speech.transfer_indices(noisy[None]), index, atol=1e-3)
    # sum of alpha less sum of beta is 1: alike octaves give their index
    np.testing.assert_allclose(speech.index_of(np.full(7, index)), index, atol=1e-9)


def test_noise_masking_and_threshold_of_speech() -> None:
    """A slow twin of IEC 60268-16, A.2.4, octave by octave; and speech under the threshold, which is not
    heard."""
    level, noise = np.array([70.0, 75, 72, 66, 60, 54, 101]), np.array([40.0, 68, 72, 30, 20, 55, 60])
    transfer = np.linspace(0.2, 0.95, 98).reshape(7, 14)
    threshold = [46.0, 27, 12, 6.5, 7.5, 8, 12]
    got = speech.heard(transfer, level, 10.0 ** (noise / 10.0))
    for k in range(7):
        signal = 10 ** (level[k] / 10)
        others = 10 ** (noise[k] / 10) + 10 ** (threshold[k] / 10)
        if k > 0:
            below = 10 * np.log10(10 ** (level[k - 1] / 10) + 10 ** (noise[k - 1] / 10))
            if below < 63:
                slope = 0.5 * below - 65
            elif below < 67:
                slope = 1.8 * below - 146.9
            else:
                slope = 0.5 * below - 59.8 if below < 100 else -10.0
            others += 10 ** ((below + slope) / 10)
        np.testing.assert_allclose(got[k], transfer[k] * signal / (signal + others), rtol=1e-12)
    silent = speech.heard(transfer, np.full(7, -80.0), np.zeros(7))
    assert speech.index_of(speech.transfer_indices(silent)) == pytest.approx(0.0, abs=1e-9)


def test_a_free_field() -> None:
    """The direct sound alone: G = 0 dB at 10 m and 20 dB at 1 m, STI excellent, LF = 0."""
    for distance, expected in ((10.0, 0.0), (1.0, 20.0)):
        direct = (distance / 343.0, FRONT, 1.0 / (4.0 * np.pi * distance**2))
        found = soundspaces_parameters.room_parameters(echogram(np.zeros(2000), direct=direct))
        np.testing.assert_allclose(found["g"], expected, atol=1e-9)
        np.testing.assert_allclose(found["lf"], 0.0, atol=1e-12)
        assert np.isnan(found["g_late"]).all() and np.isnan(found["t30"]).all()
        assert found["sti"][0, 0] > 0.9


@pytest.mark.parametrize("degrees", [0.0, 30.0, 60.0, 90.0])
def test_a_lateral_arrival(degrees: float) -> None:
    """Direct sound of energy 1 from ahead, a reflection of a half from `degrees`: LF = 0.5 sin² / 1.5, LFC with
    sin."""
    sine = np.sin(np.radians(degrees))
    side = np.cos(np.radians(degrees)) * FRONT + sine * LEFT
    found = echogram(np.zeros(300), direct=(0.01, FRONT, 1.0), arrivals=((0.04, side, 0.5),))
    np.testing.assert_allclose(parameter("lf", found), 0.5 * sine**2 / 1.5, atol=1e-12)
    np.testing.assert_allclose(parameter("lfc", found), 0.5 * sine / 1.5, atol=1e-12)
    before = echogram(np.zeros(300), direct=(0.01, FRONT, 1.0), arrivals=((0.0129, side, 0.5),))
    np.testing.assert_allclose(parameter("lf", before), 0.0, atol=1e-12)  # within 5 ms


def test_lateral_energy_of_bins_from_one_direction() -> None:
    """Of bins the square is exact, and the magnitude within its bounds: cos² <= |cos| <= 1."""
    rng = np.random.default_rng(0)
    for _ in range(20):
        d = rng.normal(size=3)
        d /= np.linalg.norm(d)
        found = echogram(np.zeros(200), direct=(0.0, FRONT, 1e-12))
        found.energy[20:60] = spherical_harmonics(d)[None, :, None]
        np.testing.assert_allclose(strength.lateral_fraction(response(found))[0], d[1] ** 2, atol=1e-5)
        cosine = strength.lateral_fraction_cosine(response(found))[0]
        assert (cosine >= d[1] ** 2 - 1e-5).all() and (cosine <= abs(d[1]) + 1e-5).all()


def test_ears_in_a_diffuse_field() -> None:
    """Two points 0.3 m apart: the coherence of a diffuse field is sin(k d) / (k d) (Cook et al. 1955); over
    a band it is the mean of that, and the coefficient its largest magnitude over delays."""
    apart = 0.3
    z, w = np.polynomial.legendre.leggauss(48)
    phi = (np.arange(96) + 0.5) * (2.0 * np.pi / 96)
    zz, pp = (x.ravel() for x in np.meshgrid(z, phi, indexing="ij"))
    rr = np.sqrt(1.0 - zz**2)
    directions = np.stack([rr * np.cos(pp), rr * np.sin(pp), zz], axis=1)
    frequency = np.arange(0.0, 12000.0, 43.0)
    phase = np.pi * frequency / 343.0 * apart * directions[:, 1:2]
    spectra = np.stack([np.exp(1j * phase), np.exp(-1j * phase)], axis=1)
    ears = EarSpectra(spectra, frequency, directions, np.repeat(w / 2.0 / 96, 96))
    got = correlation(response(echogram(exponential(1.0))), *windows_of(ears))[0]
    delays = np.linspace(-0.001, 0.001, 81)
    for k, (low, high) in enumerate(pairwise(OCTAVES)):
        f = frequency[(frequency >= low) & (frequency < high)]
        coherence = np.sinc(2.0 * f * apart / 343.0)
        expected = np.abs(
            (coherence[:, None] * np.cos(2 * np.pi * np.outer(f, delays))).mean(axis=0)
        ).max()
        assert got[k] == pytest.approx(expected, abs=2e-3), (low, got[k], expected)


def test_ears_of_a_head() -> None:
    """Sound from ahead reaches both ears alike; a diffuse field is coherent at 63 Hz and hardly at 4 kHz, and
    lies below a single arrival from ahead in every octave."""
    ahead = echogram(np.zeros(300), direct=(0.01, FRONT, 1.0))
    one = parameter("iacc", ahead)
    diffuse = parameter("iacc", echogram(exponential(1.0)))
    assert (one > 0.9).all()
    assert diffuse[0] > 0.9 and (diffuse[-3:] < 0.35).all() and (diffuse < one + 1e-6).all()
    turned = echogram(np.zeros(300), direct=(0.01, LEFT, 1.0))  # the head turns to the source
    np.testing.assert_allclose(parameter("iacc", turned), one, atol=1e-9)


def test_two_slopes_are_told_by_curvature() -> None:
    """0.5 s, and from -20 dB on 2 s: T30 exceeds T20, and the line leaves more than the 10 ‰ of ISO 3382-2, B."""
    bent = exponential(0.5) + 0.01 * exponential(2.0)
    found = response(echogram(bent))
    assert (decay.curvature(found) > 10.0).all() and (decay.nonlinearity(found) > 10.0).all()
    assert np.isnan(decay.nonlinearity(response(echogram(exponential(1.0, 0.2))))).all()


def test_offices() -> None:
    """A free field: 6.02 dB per doubling, speech of 57.4 dB(A) at 1 m; a line of STI and where it crosses."""
    r = np.array([1.0, 2.0, 3.0, 5.0, 8.0, 12.0, 20.0])  # the first and the last lie outside
    level = 57.4 - 20.0 * np.log10(r)
    zero = np.zeros(len(r))
    found = office_parameters(r, level, 0.7 - 0.025 * r, zero, zero)
    assert found.d2s.value == pytest.approx(20.0 * np.log10(2.0))
    assert found.lpas4m.value == pytest.approx(57.4 - 20.0 * np.log10(4.0))
    assert found.comfort_distance.value == pytest.approx(10.0 ** (12.4 / 20.0))
    assert found.distraction_distance.value == pytest.approx(8.0)
    assert found.privacy_distance.value == pytest.approx(20.0)
    assert len(found.distance) == 5 and found.d2s.error == pytest.approx(0.0, abs=1e-9)
    with pytest.raises(ss.ConfigError, match=r"at least 4 .* got 2"):
        office_parameters(r[:3], level[:3], zero[:3], zero[:3], zero[:3])
    speech_at_1_m = echogram(np.zeros(99), direct=(1.0 / 343.0, FRONT, 1.0 / (4.0 * np.pi)))
    edges = tuple(fractional_octaves(1, 125.0, 8000.0)[0].tolist())
    heard = speech.a_weighted_level(
        response(soundspaces_parameters.in_bands(speech_at_1_m, edges)), speech.OFFICE_SPEECH_DB
    )
    np.testing.assert_allclose(heard, 57.4, atol=0.05)  # ISO 3382-3, table 1


def test_errors_of_office_fits() -> None:
    """Slopes of levels that scatter by 1 dB, over 400 draws: their spread is the stated error, within 4
    standard errors."""
    rng, r = np.random.default_rng(1), np.array([2.0, 3.0, 4.5, 6.0, 9.0, 13.0, 16.0])
    fits = [
        office_parameters(
            r, 60 - 12 * np.log10(r) + rng.normal(0, 1, 7), 0.6 - 0.02 * r, 0 * r, 0 * r
        ).d2s
        for _ in range(400)
    ]
    z = (np.array([f.value for f in fits]) - 12 * np.log10(2)).std() / np.sqrt(
        np.mean([f.error**2 for f in fits])
    )
    assert abs(z - 1.0) < 4.0 / np.sqrt(2 * 400)


def _of_energies(name: str) -> Callable[[Response], np.ndarray]:
    """A ratio of energies, half-samples and all."""
    return lambda found: energy_ratios(found.energy, BIN_S)[name]


def test_error_bars_are_those_of_energies() -> None:
    """Energy known to 5 % before 80 ms and 5 % after, without arrivals: in closed form for G, early and late,
    C80; of LF also where directions scatter as in a diffuse field."""
    found = response(echogram(exponential(1.0), direct=None, error=0.05), halves=True)
    k, db = 6.0 * np.log(10.0), 10.0 / np.log(10.0)
    early = 1.0 - np.exp(-0.08 * k)
    expected = {
        strength.early_strength: 0.05 * db, strength.late_strength: 0.05 * db,
        strength.strength: 0.05 * db * np.hypot(early, 1.0 - early), _of_energies("c80"): 0.05 * db * np.sqrt(2.0),
    }  # fmt: skip
    for of, error in expected.items():
        np.testing.assert_allclose(spread(of(found)), error, rtol=0.02, err_msg=str(of))
    lateral = spread(strength.lateral_fraction(found))
    np.testing.assert_allclose(lateral, 0.05 * np.sqrt(4.0 / 45.0), rtol=0.15)  # a part before 5 ms
    exact = response(echogram(exponential(1.0)), halves=True)
    assert (spread(strength.strength(exact)) == 0.0).all()


def test_error_bars_of_sums_of_deposits() -> None:
    """300 echograms of 400 random deposits each, more or less: the spread of the parameters is the stated error,
    within 15 %, four standard errors of the spread."""
    rng, draws = np.random.default_rng(2), 300
    names: dict[str, Callable[[Response], np.ndarray]] = {
        "g": strength.strength,
        "lf": strength.lateral_fraction,
    }
    names |= {name: _of_energies(name) for name in ("ts", "c50")}
    values: dict[str, list[float]] = {name: [] for name in names}
    errors: dict[str, list[float]] = {name: [] for name in names}
    for _ in range(draws):
        at = np.minimum(rng.exponential(0.06, rng.poisson(400)), 0.399)  # T = 0.83 s
        d = rng.normal(size=(len(at), 3))
        moments = spherical_harmonics(d / np.linalg.norm(d, axis=1, keepdims=True))
        made = echogram(np.zeros(400), bands=(100.0, 200.0))
        np.add.at(made.energy[:, :, 0], (at * 1000).astype(int), moments)
        counts = np.array([(at < 0.08).sum(), (at >= 0.08).sum()])
        made.relative_error[:, 0] = 1.0 / np.sqrt(counts)
        found = response(made, halves=True)
        for name, of in names.items():
            got = of(found)
            values[name].append(float(got[0, 0]))
            errors[name].append(float(spread(got)[0]))
    for name in names:
        ratio = np.sqrt(np.mean(np.square(errors[name]))) / np.std(values[name])
        assert abs(ratio - 1.0) < 4.0 / np.sqrt(2.0 * draws), (name, ratio)


def test_nominal_frequencies() -> None:
    for per_octave, names in (
        (1, [63, 125, 250, 500, 1000, 2000, 4000, 8000]),
        (3, [50, 63, 80, 100, 125, 160, 200, 250, 315, 400, 500, 630, 800, 1000]),
    ):
        edges, centres = fractional_octaves(per_octave, names[0], names[-1])
        assert [nominal(float(f)) for f in centres] == names
        np.testing.assert_allclose(np.sqrt(edges[1:] * edges[:-1]), centres)


def test_what_is_asked_wrongly_is_told() -> None:
    found = echogram(exponential(1.0, 1.0), bands=DEFAULT_BANDS)
    with pytest.raises(ss.ConfigError, match=r"no 't31'; did you mean t3"):
        soundspaces_parameters.room_parameters(found, "t31")
    with pytest.raises(ss.ConfigError, match="octaves, thirds, stored"):
        soundspaces_parameters.room_parameters(found, "t30", "octave")
    with pytest.raises(ss.ConfigError, match="from 0 to 20000 Hz"):
        soundspaces_parameters.room_parameters(found, "t30", (100.0, 25000.0))
    for wrong in (np.nan, [1.0, 2.0], "loud"):
        with pytest.raises(ss.ConfigError, match="speech level: expected"):
            soundspaces_parameters.Speech(wrong)  # type: ignore[arg-type]
    with pytest.raises(ss.ConfigError, match="noise: expected"):
        soundspaces_parameters.Speech(60.0, [30.0] * 6)
    silent = soundspaces_parameters.room_parameters(echogram(np.zeros(100), direct=None))
    assert all(np.isnan(silent[name]).all() for name in PARAMETERS if name not in ("sti", "mti"))
