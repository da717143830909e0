"""What the seed paper's way of rendering does to levels and spaciousness, beside ours.

Question: What do the paper's renderer and ours make of a diffuse field, and of energy in one band alone?

Method: A diffuse field in 200 m³ that decays in .6 s, as sounds from random directions: interaural coherence
after .2 s over 20 seeds against that of the measured head in sound from everywhere, and energy of orders 1 and
2 relative to order 0 (a plane wave and a diffuse field have 0 dB). One bin of energy in 0–176 Hz: what ends up
above.

Amortised: Nothing is timed.

Takes: 2 minutes. Argument: a folder for rendering_coherence.png and rendering_leak.png (docs/figures).
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.ticker import NullFormatter

import soundspaces_sim as ss
from benchmarks.tools.record import ROOT, Table, table
from soundspaces_sim.core.numerics.axes import spherical_harmonics
from soundspaces_sim.core.numerics.bands import DEFAULT_BANDS
from soundspaces_sim.rendering.decoder import equalised_spectra
from soundspaces_sim.rendering.hrtf import load_hrtf
from soundspaces_sim.rendering.seed_paper import paper_rir

MEASURES = ("core", "echogram", "rendering")
FIGURES = ROOT / "docs" / "figures"
RATE, AFTER_S = 44100, 0.2
_COLOURS = {"default": "#0072B2", "paper": "#D55E00"}
_RENDERERS = {"default": ss.ambisonic_rir, "paper": paper_rir}


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


def _coherence_figure(
    folder: Path, centers: np.ndarray, wanted: np.ndarray, found: dict[str, np.ndarray]
) -> None:
    figure, ax = plt.subplots(figsize=(6.5, 3.6), layout="constrained")
    ax.semilogx(centers, wanted, "k--", label="measured head, sound from everywhere")
    for (name, values), marker in zip(found.items(), "os", strict=True):
        ax.semilogx(centers, values, f"{marker}-", color=_COLOURS[name], label=name)
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


def _leak(folder: Path, none: ss.Arrivals) -> dict[str, float]:
    """dB of one bin's energy in 0–176 Hz that ends up above, by renderer; and the figure."""
    energy = np.zeros((26460, 9, 4), np.float32)
    energy[13230, 0, 0] = 1.0
    edges = np.arange(len(energy) + 1) / RATE
    lone = ss.Echogram(DEFAULT_BANDS, edges, energy, None, none, np.zeros((2, 4)), True)
    figure, ax = plt.subplots(figsize=(6.5, 3.6), layout="constrained")
    leaks = {}
    for name, render in _RENDERERS.items():
        power = np.mean(
            [np.abs(np.fft.rfft(render(lone, RATE, s)[0].astype(float))) ** 2 for s in range(100)],
            axis=0,
        )
        f = np.fft.rfftfreq(render(lone, RATE, 0).shape[1], 1.0 / RATE)
        leaks[name] = float(10.0 * np.log10(power[f > 176.0].sum() / power.sum()))
        smooth = np.convolve(power, np.ones(15) / 15, "same")
        label = f"{name}: {leaks[name]:.1f} dB outside"
        ax.semilogx(f[1:], 10.0 * np.log10(smooth[1:] + 1e-12), color=_COLOURS[name], label=label)
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
    return leaks


def _orders(render: Callable[..., np.ndarray], echo: ss.Echogram) -> tuple[float, float]:
    """dB of orders 1 and 2 relative to order 0, after `AFTER_S`."""
    late = [
        (render(echo, RATE, s)[:, int(AFTER_S * RATE) :].astype(float) ** 2).sum(axis=1)
        for s in range(10)
    ]
    e = np.mean(late, axis=0)
    return float(10 * np.log10(e[1:4].sum() / e[0])), float(10 * np.log10(e[4:].sum() / e[0]))


def run(folder: str = str(FIGURES)) -> list[Table]:
    """Coherence, leak, orders; and the two figures."""
    Path(folder).mkdir(parents=True, exist_ok=True)
    fields = {"default": isotropic(0.001), "paper": isotropic(1.0 / RATE)}
    curves = {}
    for name, render in _RENDERERS.items():
        field = fields[name]

        def late(
            seed: int, render: Callable[..., np.ndarray] = render, field: ss.Echogram = field
        ) -> np.ndarray:
            return render(field, RATE, seed)

        centers, curves[name] = coherence(late, RATE, AFTER_S)
    wanted = diffuse_curve(centers)
    _coherence_figure(Path(folder), centers, wanted, curves)
    leaks = _leak(Path(folder), fields["default"].early)
    rows = [
        (
            name,
            np.sqrt(np.mean((curves[name] - wanted) ** 2)),
            *_orders(render, fields[name]),
            leaks[name],
        )
        for name, render in _RENDERERS.items()
    ]
    heads = [
        "renderer", "coherence, rms from the head's", ("order 1", "dB"), ("order 2", "dB"),
        ("energy of one bin in 0–176 Hz that ends up above", "dB"),
    ]  # fmt: skip
    return [
        table(
            "A diffuse field after .2 s, and a bin in one band",
            heads,
            rows,
            "Target of the coherence: .1.",
        )
    ]
