"""Sounds by formula: 20 families of what rings, hums, speaks, knocks and flows, each with some variants.

They stand in for the recordings of the paper (copyright-free ones of 1 s from freesound.org), which a package
cannot carry. A variant draws its parameters from family, number and seed, so the bank is the same everywhere.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import scipy  # `scipy.signal` is loaded when it is first used: it takes a second

Rng = np.random.Generator
_TAU = 2.0 * np.pi


def synthesise(family: str, variant: int, rate: int, seed: int = 0) -> np.ndarray:
    """(rate,) float64: one second of a variant of a family."""
    row = list(FAMILIES).index(family)
    rng = np.random.default_rng((seed, row, variant))
    t = np.arange(rate) / rate
    signal = FAMILIES[family][1](rng, t, rate, variant)
    edge = int(0.005 * rate)
    fade = np.ones(rate)
    fade[:edge] = np.linspace(0.0, 1.0, edge)
    fade[-edge:] = fade[:edge][::-1]
    return np.asarray(signal * fade)


def _band(x: np.ndarray, low: float, high: float, rate: int) -> np.ndarray:
    top = min(high, 0.45 * rate)
    return np.asarray(
        scipy.signal.sosfilt(
            scipy.signal.butter(2, [min(low, 0.5 * top), top], "band", fs=rate, output="sos"), x
        )
    )


def _strokes(
    rng: Rng, rate: int, count: int, stroke: Callable[[int], np.ndarray], jitter: float = 0.2
) -> np.ndarray:
    """`count` strokes at about even times, each ringing on to the end."""
    out = np.zeros(rate)
    for k in range(count):
        start = int(rate * max(0.0, (k + rng.uniform(-jitter, jitter) * (k > 0)) / count))
        tail = stroke(k)[: rate - start]
        out[start : start + len(tail)] += tail
    return out


def _partials(t: np.ndarray, f0: float, ratios: np.ndarray, decay: float, rate: int) -> np.ndarray:
    out = np.zeros(len(t))
    for k, ratio in enumerate(ratios):
        if f0 * ratio < 0.45 * rate:
            out += np.exp(-t * decay * (1.0 + 0.6 * k)) * np.sin(_TAU * f0 * ratio * t) / (1.0 + 0.5 * k)
    return out


def _ring(rng: Rng, t: np.ndarray, rate: int, variant: int) -> np.ndarray:
    """Two bells struck in turn some twenty times a second, as a telephone's."""
    f, strikes = (1180.0, 20.0) if variant == 0 else (rng.uniform(600, 1900), rng.uniform(12, 26))
    second = f * (1.26 if variant == 0 else rng.uniform(1.1, 1.5))
    phase = (t * strikes) % 1.0
    which = np.floor(t * strikes) % 2
    tone = sum(
        np.where(which == k, 1.0, 0.25) * (np.sin(_TAU * g * t) + 0.5 * np.sin(_TAU * 2.76 * g * t))
        for k, g in enumerate((f, second))
    )
    gate = (t % 0.5) < 0.4 if variant == 0 else (t % rng.uniform(0.4, 1.1)) < 0.35
    return np.asarray(np.exp(-3.0 * phase) * tone * np.where(gate, 1.0, 0.03))


def _bell(rng: Rng, t: np.ndarray, rate: int, _: int) -> np.ndarray:
    f = rng.uniform(250, 900)
    ratios = np.array([0.5, 1.0, 1.2, 1.5, 2.0, 2.66, 4.1]) * rng.uniform(0.98, 1.02, 7)
    return _strokes(
        rng, rate, int(rng.integers(1, 4)), lambda _k: _partials(t, f, ratios, rng.uniform(1, 4), rate)
    )


def _fan(rng: Rng, t: np.ndarray, rate: int, _: int) -> np.ndarray:
    noise = _band(rng.standard_normal(len(t)), rng.uniform(60, 300), rng.uniform(1000, 4000), rate)
    f = rng.uniform(15, 60)
    hum = sum(np.sin(_TAU * f * k * t) / k for k in range(2, 9))
    return np.asarray(
        noise / noise.std() * (1.0 + 0.3 * np.sin(_TAU * f * t)) + rng.uniform(0.2, 0.8) * hum
    )


def _alarm(rng: Rng, t: np.ndarray, rate: int, variant: int) -> np.ndarray:
    f, ratio, speed = rng.uniform(500, 1500), rng.uniform(1.2, 1.8), rng.uniform(1.5, 6)
    shape = np.sign(np.sin(_TAU * speed * t)) if variant % 2 else 2.0 * ((speed * t) % 1.0) - 1.0
    pitch = f * ratio ** (0.5 + 0.5 * shape)
    phase = _TAU * np.cumsum(pitch) / rate
    return np.asarray(np.sin(phase) + 0.3 * np.sin(3 * phase))


def _engine(rng: Rng, t: np.ndarray, rate: int, _: int) -> np.ndarray:
    f = rng.uniform(22, 60) * (1.0 + 0.1 * np.sin(_TAU * rng.uniform(0.5, 2) * t))
    phase = np.cumsum(f) / rate
    pulses = np.diff(np.floor(phase), prepend=0.0) * rng.uniform(0.6, 1.0, len(t))
    return _band(pulses, 40, rng.uniform(600, 1500), rate) + 0.02 * _band(
        rng.standard_normal(len(t)), 80, 900, rate
    )


def _string(rng: Rng, t: np.ndarray, rate: int, _: int) -> np.ndarray:
    """Karplus & Strong 1983."""
    base = rng.uniform(110, 330)

    def pluck(k: int) -> np.ndarray:
        period = round(rate / (base * 2.0 ** ((0, 4, 7, 12, 7, 4)[k % 6] / 12.0)))
        burst = np.zeros(rate)
        burst[:period] = rng.uniform(-1.0, 1.0, period)
        feedback = np.zeros(period + 2)
        feedback[0], feedback[period], feedback[period + 1] = 1.0, -0.497, -0.497
        return np.asarray(scipy.signal.lfilter([1.0], feedback, burst))

    return _strokes(rng, rate, int(rng.integers(3, 7)), pluck, 0.05)


def _syllable(rng: Rng, t: np.ndarray, rate: int, variant: int) -> np.ndarray:
    """A source and three formants (Fant 1960; formants of Peterson & Barney 1952), three syllables."""
    vowels = (
        (730, 1090, 2440),
        (530, 1840, 2480),
        (270, 2290, 3010),
        (570, 840, 2410),
        (300, 870, 2240),
    )
    pitch = rng.uniform(95, 230)

    def syllable(k: int) -> np.ndarray:
        n = int(rng.uniform(0.18, 0.28) * rate)
        glide = pitch * (1.05 - 0.1 * k) * (1.0 + 0.1 * np.sin(np.pi * np.arange(n) / n))
        voice = np.diff(np.floor(np.cumsum(glide / rate)), prepend=0.0)
        for f, width in zip(vowels[(variant + k) % 5], (80.0, 100.0, 140.0), strict=True):
            radius = np.exp(-np.pi * width / rate)
            a = [1.0, -2.0 * radius * np.cos(_TAU * f / rate), radius**2]
            voice = scipy.signal.lfilter([sum(a)], a, voice)
        hiss = _band(rng.standard_normal(n), 3500, 7000, rate) * np.exp(-np.arange(n) / (0.03 * rate))
        return np.asarray(
            voice * np.sin(np.pi * np.arange(n) / n) / max(np.abs(voice).max(), 1e-9) + 0.1 * hiss
        )

    return _strokes(rng, rate, 3, syllable, 0.1)


def _click(rng: Rng, t: np.ndarray, rate: int, _: int) -> np.ndarray:
    f, decay = rng.uniform(1200, 4000), rng.uniform(150, 500)
    tick = np.exp(-t * decay) * np.sin(_TAU * f * t)
    return _strokes(rng, rate, int(rng.integers(3, 12)), lambda k: tick * (1.0 if k % 2 else 0.6), 0.0)


def _water(rng: Rng, t: np.ndarray, rate: int, _: int) -> np.ndarray:
    """Bubbles: sines that rise as they die (van den Doel 2005)."""
    out = 0.02 * _band(rng.standard_normal(rate), 400, 4000, rate)
    for _bubble in range(int(rng.integers(40, 120))):
        f, start, n = rng.uniform(400, 3000), int(rng.integers(rate - 1000)), int(0.03 * rate)
        u = np.arange(min(n, rate - start)) / rate
        out[start : start + len(u)] += (
            rng.uniform(0.2, 1.0) * np.exp(-u * 120) * np.sin(_TAU * f * (1 + 8 * u) * u)
        )
    return out


def _chirp(rng: Rng, t: np.ndarray, rate: int, _: int) -> np.ndarray:
    f, depth = rng.uniform(2000, 4500), rng.uniform(0.1, 0.4)

    def call(_k: int) -> np.ndarray:
        n = int(rng.uniform(0.06, 0.15) * rate)
        u = np.arange(n) / n
        phase = _TAU * np.cumsum(f * (1 + depth * np.sin(_TAU * rng.uniform(0.5, 3) * u))) / rate
        return np.asarray(np.sin(phase) * np.sin(np.pi * u))

    return _strokes(rng, rate, int(rng.integers(3, 8)), call)


def _noise(rng: Rng, t: np.ndarray, rate: int, variant: int) -> np.ndarray:
    """Power falling as 1 / f to the power of 0, 0.5, 1, 1.5, 2: white, pink, brown and between."""
    f = np.fft.rfftfreq(rate, 1.0 / rate)
    spectrum = np.exp(1j * rng.uniform(0, _TAU, len(f))) / np.maximum(f, 40.0) ** (0.25 * (variant % 5))
    spectrum[0] = 0.0
    return np.asarray(np.fft.irfft(spectrum, rate))


def _step(rng: Rng, t: np.ndarray, rate: int, _: int) -> np.ndarray:
    f, scuff = rng.uniform(60, 140), rng.uniform(0.1, 0.6)

    def step(_k: int) -> np.ndarray:
        n = int(0.15 * rate)
        u = np.arange(n) / rate
        rub = _band(rng.standard_normal(n), 800, 4000, rate) * np.exp(-u * 50)
        return np.asarray(np.exp(-u * 45) * np.sin(_TAU * f * u) + scuff * rub)

    return _strokes(rng, rate, int(rng.integers(2, 4)), step, 0.1)


def _whistle(rng: Rng, t: np.ndarray, rate: int, _: int) -> np.ndarray:
    f = (
        rng.uniform(600, 1800)
        * (1.0 + 0.01 * np.sin(_TAU * rng.uniform(4, 7) * t))
        * (1 + rng.uniform(-0.2, 0.2) * t)
    )
    phase = _TAU * np.cumsum(f) / rate
    return np.asarray(
        np.sin(phase)
        + 0.1 * np.sin(2 * phase)
        + 0.05 * _band(rng.standard_normal(rate), 900, 5000, rate)
    )


def _drum(rng: Rng, t: np.ndarray, rate: int, _: int) -> np.ndarray:
    f, snare = rng.uniform(70, 220), rng.uniform(0.0, 0.8)
    skin = np.exp(-t * 14) * np.sin(_TAU * f * (1.0 + 0.6 * np.exp(-t * 30)) * t)
    rattle = _band(rng.standard_normal(rate), 1500, 6000, rate) * np.exp(-t * 25)
    return _strokes(rng, rate, int(rng.integers(2, 7)), lambda k: skin + snare * rattle * (k % 2), 0.05)


def _organ(rng: Rng, t: np.ndarray, rate: int, _: int) -> np.ndarray:
    f = rng.uniform(110, 350)
    chord = (1.0, 2 ** (rng.choice([3, 4]) / 12), 2 ** (7 / 12))
    return np.asarray(sum(np.sin(_TAU * f * c * k * t) / k for c in chord for k in (1, 2, 3, 4, 6, 8)))


def _glass(rng: Rng, t: np.ndarray, rate: int, _: int) -> np.ndarray:
    f = rng.uniform(1800, 3500)
    ratios = np.array([1.0, 2.32, 4.25]) * rng.uniform(0.97, 1.03, 3)
    return _strokes(
        rng, rate, int(rng.integers(2, 6)), lambda _k: _partials(t, f, ratios, rng.uniform(8, 20), rate)
    )


def _crackle(rng: Rng, t: np.ndarray, rate: int, _: int) -> np.ndarray:
    impulses = (rng.random(rate) < rng.uniform(30, 120) / rate) * rng.exponential(1.0, rate)
    return _band(impulses, 500, 6000, rate) + 0.02 * _band(rng.standard_normal(rate), 80, 500, rate)


def _beep(rng: Rng, t: np.ndarray, rate: int, _: int) -> np.ndarray:
    """Keys of a telephone (ITU-T Q.23): one of four low and one of four high tones each."""
    low, high = (697, 770, 852, 941), (1209, 1336, 1477, 1633)
    n = int(0.14 * rate)
    u = np.arange(n) / rate
    return _strokes(
        rng,
        rate,
        int(rng.integers(3, 6)),
        lambda _k: np.sin(_TAU * rng.choice(low) * u) + np.sin(_TAU * rng.choice(high) * u),
        0.0,
    )


def _buzzer(rng: Rng, t: np.ndarray, rate: int, _: int) -> np.ndarray:
    f, cut = rng.uniform(80, 240), rng.uniform(2, 9)
    saw = sum(np.sin(_TAU * f * k * t) / k for k in range(1, int(min(4000.0, 0.4 * rate) / f)))
    return np.asarray(saw * (0.15 + 0.85 * (np.sin(_TAU * cut * t) > 0)))


def _cricket(rng: Rng, t: np.ndarray, rate: int, _: int) -> np.ndarray:
    f, pulses, calls = rng.uniform(3500, 5500), rng.uniform(30, 70), rng.uniform(2, 5)
    gate = np.maximum(0.0, np.sin(_TAU * pulses * t)) * ((t * calls) % 1.0 < 0.6)
    return np.asarray(np.sin(_TAU * f * t) * gate)


Formula = Callable[[Rng, np.ndarray, int, int], np.ndarray]

#: How many variants each family has, and its formula.
FAMILIES: dict[str, tuple[int, Formula]] = {
    "ring": (6, _ring),
    "bell": (5, _bell),
    "fan": (5, _fan),
    "alarm": (6, _alarm),
    "string": (6, _string),
    "syllable": (5, _syllable),
    "click": (5, _click),
    "water": (5, _water),
    "chirp": (5, _chirp),
    "noise": (5, _noise),
    "step": (5, _step),
    "organ": (5, _organ),
    "crackle": (5, _crackle),
    "beep": (5, _beep),
    "whistle": (5, _whistle),
    "drum": (6, _drum),
    "engine": (4, _engine),
    "glass": (5, _glass),
    "buzzer": (4, _buzzer),
    "cricket": (5, _cricket),
}

#: Split of each family: 73 sounds to train with, 11 to choose by, 18 never heard before.
SPLIT_OF = {
    **dict.fromkeys(FAMILIES, "train"),
    **dict.fromkeys(("whistle", "drum"), "val"),
    **dict.fromkeys(("engine", "glass", "buzzer", "cricket"), "test"),
}
