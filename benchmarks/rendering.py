"""From energy to sound: speed per core, binaural cues against the measured head, and the paper's way beside ours.

    .venv/bin/python -m benchmarks.rendering [folder]

Prints responses per second of one core, cue errors of both decoders with their targets, and what the
paper's renderer does to levels and spaciousness; writes docs/figures/rendering_*.png, or to `folder`.
"""

from __future__ import annotations

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import sys
import time
from collections.abc import Callable
from pathlib import Path

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.ticker import NullFormatter
from scipy.signal import butter, sosfiltfilt

import soundspaces_sim as ss
from soundspaces_sim.core.numerics.axes import spherical_harmonics
from soundspaces_sim.core.numerics.bands import DEFAULT_BANDS
from soundspaces_sim.rendering.decoder import Method, equalised_spectra
from soundspaces_sim.rendering.hrtf import load_hrtf
from soundspaces_sim.rendering.seed_paper import paper_rir

FIGURES = Path(__file__).resolve().parents[1] / "docs" / "figures"
_TARGETS = {"ITD mean, us": 65.0, "ITD max, us": 145.0, "ILD 200-1500 Hz, dB": 1.2, "ILD 1500-5000 Hz, dB": 2.0,
            "ILD 5000-16000 Hz, dB": 5.5}  # fmt: skip


def per_second(run: Callable[[int], object], seconds: float = 4.0) -> float:
    """How often `run` (given a counter) goes in a second; the first call is not counted."""
    run(0)
    count, start = 0, time.perf_counter()
    while time.perf_counter() - start < seconds:
        count += 1
        run(count)
    return count / (time.perf_counter() - start)


def one_second(scene: ss.Scene) -> ss.Echogram:
    """A second of an echogram of the demo apartment, early reflections included."""
    config = ss.SimulationConfig(duration=1.0)
    return ss.simulate(scene, [[2.4, 2.7, 1.5]], [[5.0, 6.5, 1.5]], config)[0, 0]


def speed(echogram: ss.Echogram) -> None:
    print(
        f"\nresponses of 1 s per second and core ({len(echogram.early)} early reflections), and in threads"
    )
    print(
        f"{'rate':>8s}{'ambisonic':>12s}{'binaural':>12s}{'4 headings':>12s}{'batch of 64':>14s}{'loop of 64':>14s}"
    )
    turns = [(h, 0.0, 0.0) for h in (0.0, 90.0, 180.0, 270.0)]
    for rate in (16000, 44100):
        ambisonic = per_second(lambda k, rate=rate: ss.ambisonic_rir(echogram, rate, k))  # type: ignore[misc]
        binaural = per_second(
            lambda k, rate=rate: ss.binaural_rir(ss.ambisonic_rir(echogram, rate, k), rate, 10.0 * k)  # type: ignore[misc]
        )
        four = per_second(
            lambda k, rate=rate: ss.binaural_rirs(ss.ambisonic_rir(echogram, rate, k), rate, turns)  # type: ignore[misc]
        )
        batch = 64 * per_second(lambda _, rate=rate: ss.ambisonic_rirs([echogram] * 64, rate))  # type: ignore[misc]
        loop = 64 * per_second(
            lambda _, rate=rate: [ss.ambisonic_rir(echogram, rate, s) for s in range(64)]
        )  # type: ignore[misc]
        print(f"{rate:8d}{ambisonic:12.0f}{binaural:12.0f}{4 * four:12.0f}{batch:14.0f}{loop:14.0f}")


def _itd_us(left: np.ndarray, right: np.ndarray, rate: float) -> float:
    sos = butter(4, 1500.0, fs=rate, output="sos")
    a, b = (np.fft.rfft(sosfiltfilt(sos, x), 4096) for x in (left, right))
    c = np.roll(np.fft.irfft(b * a.conj(), 65536), 32768)
    return float((c.argmax() - 32768) / 16 / rate * 1e6)


def cues(method: Method) -> list[float]:
    """Mean and largest ITD error, and mean ILD errors, over 72 horizontal azimuths."""
    hrtf = load_hrtf()
    rate = round(hrtf.rate)
    f = np.fft.rfftfreq(2048, 1.0 / rate)
    itd, ild = [], []
    for azimuth in np.deg2rad(np.arange(0, 360, 5)):
        i = int((hrtf.directions @ [np.cos(azimuth), np.sin(azimuth), 0.0]).argmax())
        field = np.zeros((9, 800), np.float32)
        field[:, 400] = spherical_harmonics(hrtf.directions[i])
        ears = ss.binaural_rir(field, rate, decoder=method)
        itd.append(abs(_itd_us(*ears, rate) - _itd_us(*hrtf.ir[i], rate)))
        row = []
        for low, high in ((200.0, 1500.0), (1500.0, 5000.0), (5000.0, 16000.0)):
            use = (f >= low) & (f < high)
            level = [
                10.0 * np.log10((np.abs(np.fft.rfft(x, 2048)[:, use]) ** 2).sum(axis=1))
                for x in (ears, hrtf.ir[i])
            ]
            row.append(abs((level[0][0] - level[0][1]) - (level[1][0] - level[1][1])))
        ild.append(row)
    return [float(np.mean(itd)), float(np.max(itd)), *np.mean(ild, axis=0)]


def print_cues() -> None:
    print("\nbinaural cues against the measured KEMAR, 72 horizontal azimuths")
    print(f"{'':<24s}{'target':>10s}{'aligned':>10s}{'magls':>10s}")
    columns = [cues("aligned"), cues("magls")]
    for k, (name, target) in enumerate(_TARGETS.items()):
        print(f"{name:<24s}{target:10.1f}{columns[0][k]:10.2f}{columns[1][k]:10.2f}")


def isotropic(bin_s: float, volume: float = 200.0, reverb: float = 0.6) -> ss.Echogram:
    """Echogram of a diffuse field: sounds from random directions, 4 pi c^3 t^2 / V per second as in any room
    of `volume` m³, whose energies decay in `reverb` s; in bins of `bin_s`, each with exact moments."""
    rng = np.random.default_rng(0)
    end = 0.6
    count = rng.poisson(4.0 * np.pi * 343.0**3 * end**3 / (3.0 * volume))
    time_s = end * rng.random(count) ** (1.0 / 3.0)
    d = rng.normal(size=(count, 3))
    moments = spherical_harmonics(d / np.linalg.norm(d, axis=1, keepdims=True))
    weight = 10.0 ** (-6.0 * time_s / reverb) / time_s**2
    bins = round(end / bin_s)
    at = np.minimum((time_s / bin_s).astype(int), bins - 1)
    table = np.stack([np.bincount(at, weight * m, bins) for m in moments.T], axis=1)
    energy = np.repeat(table[:, :, None], 4, axis=2).astype(np.float32)
    none = ss.Arrivals(np.empty(0), np.empty((0, 4)), np.empty((0, 3)), np.empty((0, 2), int))
    return ss.Echogram(
        DEFAULT_BANDS, np.arange(bins + 1) * bin_s, energy, None, none, np.zeros((2, 4)), True
    )


def coherence(
    render: Callable[[int], np.ndarray], rate: int, start: float
) -> tuple[np.ndarray, np.ndarray]:
    """Third-octave frequencies, and interaural coherence of what comes after `start` s, over 20 seeds."""
    cross = np.zeros((3, 0))
    for seed in range(20):
        ears = ss.binaural_rir(render(seed), rate)[:, int(start * rate) :].astype(float)
        ears /= 10.0 ** (-3.0 * np.arange(ears.shape[1]) / rate / 0.6)  # so that all of the decay counts
        left, right = np.fft.rfft(ears, axis=1)
        power = np.stack([np.abs(left) ** 2, np.abs(right) ** 2, (left * right.conj()).real])
        cross = power if seed == 0 else cross + power
    f = np.linspace(0.0, 0.5 * rate, cross.shape[1])
    centers = 1000.0 * 2.0 ** (np.arange(-7, 10) / 3.0)
    out = []
    for center in centers:
        ll, rr, lr = cross[:, np.abs(np.log2(np.maximum(f, 1e-9) / center)) < 1 / 6].sum(axis=1)
        out.append(lr / np.sqrt(ll * rr))
    return centers, np.array(out)


def diffuse_curve(centers: np.ndarray) -> np.ndarray:
    """The measured set's in a diffuse field."""
    hrtf = load_hrtf()
    spectra = equalised_spectra(hrtf)
    field = np.einsum("pef,p,pgf->egf", spectra, hrtf.weights, spectra.conj()).real
    f = np.fft.rfftfreq(2048, 1.0 / hrtf.rate)
    use = [np.abs(np.log2(np.maximum(f, 1e-9) / c)) < 1 / 6 for c in centers]
    return np.array(
        [field[0, 1, u].sum() / np.sqrt(field[0, 0, u].sum() * field[1, 1, u].sum()) for u in use]
    )


def compare_with_the_paper(folder: Path) -> None:
    """Figures: coherence of the late sound, spectrum of one arrival in one band; level per order."""
    rate = 44100
    ours, theirs = isotropic(0.001), isotropic(1.0 / rate)
    centers, mine = coherence(lambda s: ss.ambisonic_rir(ours, rate, s), rate, 0.2)
    _, paper = coherence(lambda s: paper_rir(theirs, rate, s), rate, 0.2)
    wanted = diffuse_curve(centers)
    print(
        "\na diffuse field in 200 m3, from 0.2 s on: interaural coherence, rms difference from the measured head's"
    )
    print(
        f"default {np.sqrt(np.mean((mine - wanted) ** 2)):.3f}, paper {np.sqrt(np.mean((paper - wanted) ** 2)):.3f}"
    )
    figure, ax = plt.subplots(figsize=(6.5, 3.6), layout="constrained")
    ax.semilogx(centers, wanted, "k--", label="measured head, sound from everywhere")
    ax.semilogx(centers, mine, "o-", color="#0072B2", label="default")
    ax.semilogx(centers, paper, "s-", color="#D55E00", label="paper")
    ax.set(
        xlabel="frequency (Hz)",
        ylabel="interaural coherence",
        title="how alike both ears hear a room's late sound (200 m³, after 0.2 s)",
    )
    ticks = [200, 500, 1000, 2000, 5000]
    ax.set_xticks(ticks, [f"{tick:,}" for tick in ticks])
    ax.xaxis.set_minor_formatter(NullFormatter())
    ax.grid(alpha=0.3)
    ax.legend(frameon=False)
    figure.savefig(folder / "rendering_coherence.png", dpi=110)

    table = np.zeros((26460, 9, 4), np.float32)
    table[13230, 0, 0] = 1.0
    edges = np.arange(len(table) + 1) / rate
    lone = ss.Echogram(DEFAULT_BANDS, edges, table, None, ours.early, np.zeros((2, 4)), True)
    figure, ax = plt.subplots(figsize=(6.5, 3.6), layout="constrained")
    for name, render, colour in (
        ("default", ss.ambisonic_rir, "#0072B2"),
        ("paper", paper_rir, "#D55E00"),
    ):
        power = np.mean(
            [np.abs(np.fft.rfft(render(lone, rate, s)[0].astype(float))) ** 2 for s in range(100)],
            axis=0,
        )
        f = np.fft.rfftfreq(render(lone, rate, 0).shape[1], 1.0 / rate)
        leak = 10.0 * np.log10(power[f > 176.0].sum() / power.sum())
        print(f"energy of one bin in 0-176 Hz that ends up above 176 Hz: {name} {leak:.1f} dB")
        smooth = np.convolve(power, np.ones(15) / 15, "same")
        ax.semilogx(
            f[1:],
            10.0 * np.log10(smooth[1:] + 1e-12),
            color=colour,
            label=f"{name}: {leak:.1f} dB outside",
        )
    ax.axvspan(20.0, 176.0, color="#777777", alpha=0.15, label="the band")
    ax.set(
        xlim=(20, 20000),
        ylim=(-70, 10),
        xlabel="frequency (Hz)",
        ylabel="level (dB)",
        title="sound in one band alone (0–176 Hz): what spills out of it",
    )
    ax.grid(alpha=0.3)
    ax.legend(frameon=False)
    figure.savefig(folder / "rendering_leak.png", dpi=110)

    print(
        "energy of orders 1 and 2 after 0.2 s, re order 0 (a plane wave and a diffuse field have 0 dB)"
    )
    for name, render, echo in (("default", ss.ambisonic_rir, ours), ("paper", paper_rir, theirs)):
        late = [
            (render(echo, rate, s)[:, int(0.2 * rate) :].astype(float) ** 2).sum(axis=1)
            for s in range(10)
        ]
        e = np.mean(late, axis=0)
        print(
            f"{name:>8s}: {10 * np.log10(e[1:4].sum() / e[0]):6.1f} {10 * np.log10(e[4:].sum() / e[0]):6.1f} dB"
        )


def main() -> None:
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else FIGURES
    folder.mkdir(parents=True, exist_ok=True)
    speed(one_second(ss.load_scene("demo")))
    print_cues()
    compare_with_the_paper(folder)


if __name__ == "__main__":
    main()
