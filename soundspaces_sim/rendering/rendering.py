"""Settings of a rendering, and the signals that echograms give with them.

Conventions: responses are (channels, n) float32, ambisonic ones ACN/SN3D in world axes, binaural ones left ear
first; dry signals are mono (m,). The noise of a response is seeded by (dataset seed, source, listener).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from soundspaces_sim.core.registry import Entry, of_neighbour
from soundspaces_sim.echogram.directed import directed
from soundspaces_sim.echogram.echogram import Echogram
from soundspaces_sim.echogram.endpoints import Directivity
from soundspaces_sim.rendering import auralise
from soundspaces_sim.rendering.ambisonics import pair_seed
from soundspaces_sim.rendering.binaural import binaural_rirs
from soundspaces_sim.rendering.directivity import as_directivity
from soundspaces_sim.rendering.ears import Ears, as_ears, ear_rirs
from soundspaces_sim.rendering.higher_orders import higher_order_rir
from soundspaces_sim.rendering.microphones import MicrophoneArray, array_rir
from soundspaces_sim.rendering.renderers import check_renderer, find_renderer

_MOVING = Entry("soundspaces_renderers.moving:render_ways", "moving sources, listeners", "renderers")


@dataclass(frozen=True)
class Rendering:
    """Sampling `rate` in Hz; `renderer`, a name of `rendering.renderers`; `ears`, `Ears` or the path of a SOFA file
    (None: KEMAR); `seed` of the noise; speed of sound `c` in m/s. Raises `ConfigError`."""

    rate: int
    renderer: str
    ears: str | Path | Ears | None
    seed: int
    c: float

    def __post_init__(self) -> None:
        check_renderer(self.renderer)
        as_ears(self.ears)

    def directed(
        self,
        echogram: Echogram,
        back: Echogram | None,
        source: Directivity | str | None,
        listener: Directivity | str | None,
    ) -> Echogram:
        """The echogram with directive ends, given themselves or by name; `back` is that of the reverse pair,
        which a directive source needs. See `echogram.directed`."""
        emits, receives = as_directivity(source, "source"), as_directivity(listener, "listener")
        return directed(echogram, None if emits is None else back, emits, receives, self.c)

    def ambisonic(self, echogram: Echogram, s: int, l: int) -> np.ndarray:
        """(9, n) response of the pair (s, l)."""
        return find_renderer(self.renderer)(echogram, self.rate, pair_seed(self.seed, s, l))

    def ambisonic_of_order(self, echogram: Echogram, order: int, s: int, l: int) -> np.ndarray:
        """((order + 1)², n) response of the pair (s, l), order 3 to 7; see `higher_orders`."""
        return higher_order_rir(echogram, self.rate, pair_seed(self.seed, s, l), order)

    def microphones(self, echogram: Echogram, array: MicrophoneArray, s: int, l: int) -> np.ndarray:
        """(k, n) responses of the pair (s, l) at an array of microphones."""
        return array_rir(echogram, array, self.rate, pair_seed(self.seed, s, l), self.c)

    @property
    def decodes(self) -> bool:
        """Whether binaural responses follow from ambisonic ones alone; `Ears` may need the echogram."""
        return not isinstance(self.ears, Ears)

    def decoded(self, field: np.ndarray, orientations_deg: np.ndarray) -> np.ndarray:
        """(k, 2, n) of an ambisonic response (9, n), for k heads (k, 3) of heading, pitch and roll."""
        assert not isinstance(self.ears, Ears)
        return binaural_rirs(field, self.rate, orientations_deg, self.ears)

    def binaural(self, echogram: Echogram, s: int, l: int, orientations_deg: np.ndarray) -> np.ndarray:
        """(k, 2, n) responses of the pair (s, l), for k heads (k, 3) of heading, pitch and roll."""
        if not isinstance(self.ears, Ears):
            return self.decoded(self.ambisonic(echogram, s, l), orientations_deg)

        def render(of: Echogram) -> np.ndarray:
            return self.ambisonic(of, s, l)

        return ear_rirs(echogram, render, self.rate, orientations_deg, self.ears, self.c)

    def dry(self, audio: ArrayLike) -> np.ndarray:
        """(m,) float32. Raises `ConfigError` for anything but a finite mono signal."""
        return auralise.as_mono(audio)

    def convolve(self, audio: ArrayLike, response: np.ndarray) -> np.ndarray:
        """(channels, m + n - 1): a dry signal through a response."""
        return auralise.convolve(auralise.as_mono(audio), response)

    def mix(self, signals: Sequence[np.ndarray]) -> np.ndarray:
        """Sum of signals (channels, any length), as long as the longest."""
        return auralise.add_up(signals)

    def cross_fade(
        self, dry: np.ndarray, responses: Sequence[np.ndarray], moving: Literal["source", "listener"]
    ) -> np.ndarray:
        """(channels, n): a dry signal through responses at even times, see `auralise.along_path`."""
        return auralise.along_path(dry, responses, moving)

    def spectrogram(self, audio: ArrayLike, response: np.ndarray) -> np.ndarray:
        """(65, frames, 2): `auralise.spectrogram` of a dry signal through a response, as long as the signal."""
        dry = auralise.as_mono(audio)
        return auralise.spectrogram(auralise.convolve(dry, response)[:, : len(dry)], self.rate)

    def moving(
        self,
        audio: ArrayLike,
        sources: ArrayLike,
        listeners: ArrayLike,
        orientations_deg: ArrayLike,
        source: Directivity | str | Sequence[Directivity | str | None] | None,
        *,
        points: np.ndarray,
        echogram: Callable[[int, int], Echogram],
        duration: float,
    ) -> np.ndarray:
        """(2, n): a dry signal whose source and listener move (`rendering.moving`).

        `sources` and `listeners`: rows (t, x, y, z) in s and m. `points` (N, 3) m, at least two: between them
        `echogram` gives echograms of `duration` s. Raises `PointError`, `ConfigError`.
        """
        render = of_neighbour("sources and listeners that move in metres", _MOVING)
        return render(
            self, audio, sources, listeners, orientations_deg, source, points, echogram, duration
        )
