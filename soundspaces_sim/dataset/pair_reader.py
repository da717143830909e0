"""Responses of one pair: stored, or rendered from its echogram.

Echograms and tables are read without the renderer; `PairReader._rendering` is the one place that loads it, when a
signal is first asked for.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from soundspaces_sim import rendering
from soundspaces_sim.core.config import check_rate
from soundspaces_sim.core.numerics.axes import check_degrees, check_head
from soundspaces_sim.dataset.format.manifest import Manifest
from soundspaces_sim.dataset.random_materials import RandomMaterials, draw_furnished
from soundspaces_sim.dataset.stored import StoredResponses
from soundspaces_sim.echogram.echogram import Echogram
from soundspaces_sim.echogram.low_response import LowResponse
from soundspaces_sim.echogram.refurnish import Materials
from soundspaces_sim.rendering.renderers import check_renderer

if TYPE_CHECKING:
    from soundspaces_sim.echogram.endpoints import Directivity
    from soundspaces_sim.rendering.ears import Ears
    from soundspaces_sim.rendering.microphones import MicrophoneArray
    from soundspaces_sim.rendering.rendering import Rendering


class PairReader:
    """A dataset's responses, pair by pair: the base of `RirDataset`, whose arguments these are."""

    def __init__(
        self,
        path: str | Path,
        rate: int | None,
        hrtf: str | Path | Ears | None,
        renderer: str | None,
        materials: Materials | None = None,
        force: bool = False,
    ) -> None:
        self._stored = StoredResponses(path, materials, force)
        self.path = self._stored.path
        self.manifest: Manifest = self._stored.manifest
        self.points = self._stored.points
        own = self.manifest.config.dataset
        self.rate = own.rate if rate is None else check_rate(rate)
        self.hrtf, self.renderer = hrtf, own.renderer if renderer is None else renderer
        if renderer is not None:
            check_renderer(renderer)
        if not (hrtf is None or isinstance(hrtf, str | Path)):
            self._rendering(self.rate)  # raises `ConfigError` for other ears

    def _rendering(self, rate: int) -> Rendering:
        """What makes signals of echograms; imports the renderer."""
        config = self.manifest.config
        return rendering.Rendering(
            rate, self.renderer, self.hrtf, config.dataset.seed, config.simulation.c
        )

    def echogram(
        self,
        s: int,
        l: int,
        /,
        source: Directivity | str | None = None,
        listener: Directivity | str | None = None,
        *,
        materials: Materials | None = None,
        force: bool = False,
    ) -> Echogram:
        """Energy against delay, per band, from point `s` to point `l`; with a `source` or a `listener` that is
        directive, see `directed.directed`; with `materials`, as `open_dataset` takes them, for this pair alone.
        Raises `PairIndexError`, `DatasetError`, `MaterialError`."""
        echogram = self._stored.echogram(s, l, materials, force)
        if source is None and listener is None:
            return echogram
        back = None if source is None else self._stored.echogram(l, s, materials, force)
        return self._rendering(self.rate).directed(echogram, back, source, listener)

    def low(self, s: int, l: int, /) -> LowResponse:
        """Pressure and velocity from point `s` to point `l` below an edge, as simulated with waves
        (`[simulation.low]`). Raises `PairIndexError`, `DatasetError` without waves."""
        return self._stored.low(s, l)

    def drawn(
        self, s: int, l: int, /, materials: RandomMaterials, rng: np.random.Generator
    ) -> tuple[Echogram, np.ndarray]:
        """The echogram from point `s` to point `l` with `materials` that `rng` draws, and their absorption (M,
        bands), in the order of `self.materials`. Raises `PairIndexError`, `DatasetError` without counts,
        `MaterialError`."""
        return draw_furnished(self._stored.counted(s, l), materials, rng)

    def ambisonic(
        self,
        s: int,
        l: int,
        /,
        rate: int | None = None,
        *,
        source: Directivity | str | None = None,
        order: int = 2,
    ) -> np.ndarray:
        """((order + 1)², n) float32 response, ACN/SN3D, world axes: (9, n), or of `order` 3 to 7, whose
        reverberation no renderer changes (`rendering.higher_orders`). Raises `ConfigError`."""
        s, l, rate = self._asked(s, l, rate)
        if order != 2:
            return self._rendering(rate).ambisonic_of_order(self.echogram(s, l, source), order, s, l)
        if source is None and self._stored.has_waveforms(rate, self.renderer):
            return self._stored.ambisonic(s, l)
        return self._rendering(rate).ambisonic(self.echogram(s, l, source), s, l)

    def monaural(
        self,
        s: int,
        l: int,
        /,
        rate: int | None = None,
        *,
        source: Directivity | str | None = None,
        listener: Directivity | str | None = None,
    ) -> np.ndarray:
        """(1, n) float32 response of a microphone, omnidirectional or with the directivity `listener`."""
        if listener is None:
            return self.ambisonic(s, l, rate, source=source)[:1]
        s, l, rate = self._asked(s, l, rate)
        return self._rendering(rate).ambisonic(self.echogram(s, l, source, listener), s, l)[:1]

    def microphones(
        self,
        s: int,
        l: int,
        /,
        array: MicrophoneArray,
        rate: int | None = None,
        *,
        source: Directivity | str | None = None,
    ) -> np.ndarray:
        """(k, n) float32 responses of an array of microphones centred at point `l`, phases together."""
        s, l, rate = self._asked(s, l, rate)
        return self._rendering(rate).microphones(self.echogram(s, l, source), array, s, l)

    def binaural(
        self,
        s: int,
        l: int,
        /,
        heading_deg: float = 0.0,
        rate: int | None = None,
        *,
        pitch_deg: float = 0.0,
        roll_deg: float = 0.0,
        source: Directivity | str | None = None,
    ) -> np.ndarray:
        """(2, n) float32 response at the ears of a head; angles as in `axes.head_matrix`."""
        head = check_head(heading_deg, pitch_deg, roll_deg)
        return self.binaurals(s, l, [head], rate, source=source)[0]

    def binaurals(
        self,
        s: int,
        l: int,
        /,
        orientations_deg: ArrayLike,
        rate: int | None = None,
        *,
        source: Directivity | str | None = None,
    ) -> np.ndarray:
        """(k, 2, n) float32: the same for k heads (k, 3) of heading, pitch and roll, at less cost."""
        s, l, rate = self._asked(s, l, rate)
        turns = check_degrees(orientations_deg, "heading, pitch and roll").reshape(-1, 3)
        stored = source is None and self._stored.has_waveforms(rate, self.renderer)
        level = not turns[:, 1:].any()
        headings = self.manifest.config.dataset.headings
        if stored and self.hrtf is None and level and all(h % 360.0 in headings for h in turns[:, 0]):
            return self._stored.binaural(s, l, turns[:, 0])
        made = self._rendering(rate)
        if stored and made.decodes:
            return made.decoded(self._stored.ambisonic(s, l), turns)
        return made.binaural(self.echogram(s, l, source), s, l, turns)

    def rendered(
        self, echogram: Echogram, s: int, l: int, heading_deg: float | None = None
    ) -> np.ndarray:
        """(9, n) float32 response of an `echogram` from point `s` to point `l`; (2, n) at a head with a heading."""
        made = self._rendering(self.rate)
        if heading_deg is None:
            return made.ambisonic(echogram, s, l)
        turns = check_degrees([(heading_deg, 0.0, 0.0)], "heading, pitch and roll").reshape(-1, 3)
        return made.binaural(echogram, s, l, turns)[0]

    def _asked(self, s: int, l: int, rate: int | None) -> tuple[int, int, int]:
        """Source, listener and rate of what is asked for. Raises `PairIndexError`, `ConfigError`."""
        s, l = self._stored.row(s, "source"), self._stored.row(l, "listener")
        return s, l, self.rate if rate is None else check_rate(rate)
