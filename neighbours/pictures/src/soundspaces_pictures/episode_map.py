"""The map of an episode: where the sound is loud, the way so far, and what is perceived (extra ``figures``)."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from soundspaces_sim import RirDataset, open_dataset
from soundspaces_sim.parts import (
    HEADINGS,
    EpisodeState,
    Observation,
    need_extras as need,
    read_floorplan,
    storeys_of,
)

need("a picture", "figures")

from matplotlib.axes import Axes  # noqa: E402 - after it is known to be there
from matplotlib.backends.backend_agg import FigureCanvasAgg  # noqa: E402
from matplotlib.figure import Figure  # noqa: E402

from soundspaces_pictures.field import Field, band_field, draw_field  # noqa: E402

_DPI = 80
_AGENT, _TRAIL = "#000000", "#009E73"


def goal_field(ds: RirDataset, goal: int) -> Field:
    """The field of a source at a point, on its storey; of all frequencies where waveforms alone are stored."""
    source = ds.points[goal]
    storey = storeys_of(read_floorplan(ds.path), ds.points)
    rows = np.flatnonzero(storey == storey[goal])
    if ds.manifest.config.dataset.store != "waveform":
        return band_field(source, ds.points[rows], [ds.echogram(goal, int(n)) for n in rows])
    rows = rows[rows != goal]
    table = ds.table()
    visible = table["visible"][table["source"] == goal][rows - (rows > goal)]
    energy = [float(np.square(ds.ambisonic(goal, int(n))[0], dtype=float).sum()) for n in rows]
    direct = visible / np.sum((ds.points[rows] - source) ** 2, axis=1)
    rest = np.maximum(4.0 * np.pi * np.array(energy) - direct, 0.0)
    return Field(source, ds.points[rows], visible.astype(float), rest, visible, "all frequencies")


def draw_trail(ax: Axes, ds: RirDataset, goal: int, trail: Sequence[int], title: str = "") -> None:
    """Map with the sound's level behind it, and the way of an agent: states as in `graph`."""
    plan, spacing = read_floorplan(ds.path), ds.manifest.config.grid.spacing
    draw_field(ax, plan, goal_field(ds, goal), spacing)
    places = ds.points[[s >> 2 for s in trail], :2]
    # Ways that go back over themselves stay visible side by side.
    shift = 0.06 * np.stack([np.sin(np.arange(len(places))), np.cos(np.arange(len(places)))], axis=1)
    ax.plot(*(places + shift).T, color=_TRAIL, lw=2.0, zorder=8)
    ax.plot(*places[0], "o", color=_TRAIL, mec="black", ms=8, zorder=9)
    ax.plot(*places[-1], "s", color=_TRAIL, mec="black", ms=8, zorder=9)
    ax.set_title(title, fontsize=9)


class MapPage:
    """A page that is drawn once and then brought up to date: map, and, with an observation, what is perceived."""

    def __init__(self, ds: RirDataset, goal: int, perceived: bool) -> None:
        self.ds = ds
        self.figure = Figure(figsize=(9.0 if perceived else 6.4, 4.8), dpi=_DPI, layout="constrained")
        self.canvas = FigureCanvasAgg(self.figure)
        if perceived:
            grid = self.figure.add_gridspec(3, 2, width_ratios=[2.4, 1.0])
            self.map = self.figure.add_subplot(grid[:, 0])
            self.panels = [self.figure.add_subplot(grid[k, 1]) for k in range(3)]
        else:
            self.map, self.panels = self.figure.add_subplot(), []
        draw_trail(self.map, ds, goal, [4 * goal])
        for artist in list(self.map.lines)[-3:]:
            artist.remove()
        (self._way,) = self.map.plot([], [], color=_TRAIL, lw=2.0, zorder=8)
        (self._agent,) = self.map.plot([], [], color=_AGENT, ms=13, ls="", mec="white", zorder=10)
        self.map.set_title("action", fontsize=9)
        for _ in range(
            2
        ):  # constrained layout settles at the second drawing; then it stays, and pages compare
            self.canvas.draw()
        self.figure.set_layout_engine("none")

    def draw(
        self, state: EpisodeState, trail: Sequence[int], observation: Observation | None = None
    ) -> np.ndarray:
        """(height, width, 3) uint8."""
        places = self.ds.points[[s >> 2 for s in trail], :2]
        return self.draw_at(state, places, HEADINGS[trail[-1] & 3], observation)

    def draw_at(
        self,
        state: Any,
        places: np.ndarray,
        heading: float,
        observation: Observation | None,
    ) -> np.ndarray:
        """(height, width, 3) uint8 of a state on the graph or elsewhere: `places` (n, 2) m of its way, `heading` in
        degrees at the end."""
        self._way.set_data(*places.T)
        self._agent.set_data(places[-1:, 0], places[-1:, 1])
        self._agent.set_marker((3, 0, round(heading) - 90))
        ending = ", STOP" if state.stopped else ", bump" if state.collided else ""
        what = f"{state.episode.scene}, {state.episode.sound}"
        left = f"{state.distance:.0f} m to go{ending}"
        self.map.set_title(f"{what}: action {state.steps}, {left}", fontsize=9)
        for panel, (name, picture) in zip(self.panels, _pictures(observation or {}), strict=False):
            _show(panel, name, picture)
        self.canvas.draw()
        return np.asarray(self.canvas.buffer_rgba())[..., :3].copy()


def _pictures(observation: Observation) -> list[tuple[str, np.ndarray]]:
    out = []
    if "spectrogram" in observation:
        out += [
            (f"{ear} ear", observation["spectrogram"][::-1, :, k])
            for k, ear in enumerate(("left", "right"))
        ]
    if "depth" in observation:
        out.append(("depth", observation["depth"][:, :, 0]))
    return out


def _show(panel: Axes, name: str, picture: np.ndarray) -> None:
    panel.clear()
    if name == "depth":
        panel.imshow(np.sqrt(picture), cmap="gray", vmin=0.0, vmax=1.0, aspect="equal")
    else:
        panel.imshow(picture, cmap="magma", vmin=0.0, vmax=3.0, aspect="auto")
    panel.set_title(name, fontsize=8)
    panel.set_xticks([])
    panel.set_yticks([])


@lru_cache(maxsize=2)
def _page(path: Path, goal: int) -> MapPage:
    return MapPage(open_dataset(path), goal, perceived=False)


def map_frame(ds: RirDataset, state: EpisodeState, trail: Sequence[int]) -> np.ndarray:
    """(height, width, 3) uint8: the map of a walk that is under way."""
    return _page(ds.path, state.episode.goal).draw(state, trail)
