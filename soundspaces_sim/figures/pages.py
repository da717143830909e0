"""Whole pictures by name, of a dataset or of a scene that is simulated for them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal, get_args

import matplotlib
import numpy as np

matplotlib.use("Agg")  # pictures are files here

import matplotlib.pyplot as plt
from matplotlib.animation import FuncAnimation, PillowWriter
from matplotlib.figure import Figure

from soundspaces_sim.base.config import GridConfig, SimulationConfig
from soundspaces_sim.base.errors import ConfigError
from soundspaces_sim.echo.echogram import Echogram
from soundspaces_sim.figures.decay import draw_decay
from soundspaces_sim.figures.field import draw_error, draw_field, levels_of
from soundspaces_sim.figures.lobes import draw_lobes
from soundspaces_sim.figures.plan import draw_map
from soundspaces_sim.figures.response import draw_spectrogram, draw_waveform
from soundspaces_sim.loaders import load_scene
from soundspaces_sim.places.floorplan import make_floorplan
from soundspaces_sim.places.graph import make_graph
from soundspaces_sim.places.grid import make_grid
from soundspaces_sim.places.records import FloorPlan, Grid
from soundspaces_sim.reading.dataset import open_dataset
from soundspaces_sim.scene.scene import Scene
from soundspaces_sim.sound.ambisonics import ambisonic_rir
from soundspaces_sim.sound.binaural import binaural_rir
from soundspaces_sim.storage.floorplan import read_floorplan
from soundspaces_sim.storage.manifest import NAME
from soundspaces_sim.transport.simulate import simulate

What = Literal["map", "field", "lobes", "decay", "rir", "error"]
_RATE = 44100
_MOST_FRAMES = 24
_LEVEL_WALKS = 250  # of a scene: enough for levels and directions
_WALKS = SimulationConfig().walks  # for decays, responses, and the error that a dataset would have


@dataclass(frozen=True)
class Subject:
    """What pictures are made of: the plan, the points (N, 3) with the walking graph, and echograms.

    `grid` is there for a scene, which knows what was pruned.
    """

    name: str
    plan: FloorPlan
    grid: Grid | None
    points: np.ndarray
    nodes: np.ndarray
    edges: np.ndarray
    spacing: float
    path: Path | None  # of a dataset
    scene: Scene | None

    def echograms(self, source: int, listeners: np.ndarray, walks: int = _LEVEL_WALKS) -> list[Echogram]:
        """From the dataset, or simulated with so many walks."""
        if self.path is not None:
            with open_dataset(self.path) as ds:
                return [ds.echogram(source, int(l)) for l in listeners]
        assert self.scene is not None
        scene = self.scene
        echoes = simulate(
            scene, self.points[[source]], self.points[listeners], SimulationConfig(walks=walks)
        )
        return [echoes[0, i] for i in range(len(listeners))]


def load_subject(source: str | Path, spacing: float | None = None) -> Subject:
    """A dataset folder, or anything `load_scene` takes. Raises the errors of either."""
    path = Path(source)
    if (path / NAME).is_file():
        with open_dataset(path) as ds:
            found = ds.manifest
            edges = np.array(found.edges, int).reshape(-1, 2)
            return Subject(
                ds.scene, read_floorplan(path), None, ds.points, np.array(found.nodes, int), edges,
                found.config.grid.spacing, path, None,
            )  # fmt: skip
    scene = load_scene(source)
    grid = make_grid(scene, config=GridConfig(spacing=spacing or 0.5))
    graph = make_graph(scene, grid)
    return Subject(
        scene.name, make_floorplan(scene, grid), grid, grid.points, graph.nodes, graph.edges, grid.spacing, None,
        scene,
    )  # fmt: skip


def draw_page(
    subject: Subject, what: What, source: int | None = None, listeners: tuple[int, ...] = ()
) -> Figure:
    """One picture. `source`: a point, by default the one nearest to a quarter of the plan; `listeners`: points
    for lobes, decay and rir, by default chosen near and far. Raises `ConfigError`."""
    if what not in get_args(What):
        raise ConfigError(f"what: expected one of {', '.join(get_args(What))}, got {what!r}")
    source = _default_source(subject) if source is None else source
    for point in (source, *listeners):
        if not 0 <= point < len(subject.points):
            raise ConfigError(
                f"point {point} is out of range: there are points 0 to {len(subject.points) - 1}"
            )
    height = float(subject.points[source, 2])
    storey = _storey(subject, height)
    if what in ("decay", "rir"):
        listener = listeners[0] if listeners else _default_listeners(subject, source)[0]
        return _of_a_pair(subject, what, source, listener)
    figure, ax = plt.subplots(figsize=_size(subject.plan, storey), layout="constrained")
    place = subject.points[source]
    if what == "map":
        draw_map(
            ax, subject.plan, subject.grid, subject.points, subject.edges, subject.nodes, storey, height
        )
        ax.set_title(f"{subject.name}: points and walking graph, {subject.spacing:g} m")
    elif what == "lobes":
        chosen = listeners or tuple(_default_listeners(subject, source))
        echograms = subject.echograms(source, np.array(chosen))
        draw_lobes(ax, subject.plan, place, subject.points[list(chosen)], echograms, storey)
        ax.set_title(f"{subject.name}: where the sound of point {source} comes from")
    else:
        level = np.flatnonzero(np.isclose(subject.points[:, 2], height, atol=0.1))
        echograms = subject.echograms(source, level, _LEVEL_WALKS if what == "field" else _WALKS)
        points = subject.points[level]
        if what == "field":
            draw_field(ax, subject.plan, points, place, levels_of(echograms), subject.spacing, storey)
            ax.set_title(f"{subject.name}: level of a source at point {source}")
        else:
            error = np.array([float(e.relative_error[1].max()) for e in echograms])
            draw_error(ax, subject.plan, points, place, error, subject.spacing, storey)
            ax.set_title(f"{subject.name}: largest error of any band, source at point {source}")
    return figure


def animate_field(subject: Subject, path: str | Path) -> int:
    """Write a GIF of the field over sources that walk through the scene; the number of frames."""
    height = float(subject.points[_default_source(subject), 2])
    storey = _storey(subject, height)
    level = np.flatnonzero(np.isclose(subject.points[:, 2], height, atol=0.1))
    order = level[np.lexsort((subject.points[level, 1], subject.points[level, 0]))]
    sources = order[np.linspace(0, len(order) - 1, min(_MOST_FRAMES, len(order))).astype(int)]
    levels = [levels_of(subject.echograms(int(s), level)) for s in sources]
    finite = np.concatenate([x[np.isfinite(x)] for x in levels])
    limits = float(np.percentile(finite, 1)), float(np.percentile(finite, 99))
    figure = plt.figure(figsize=_size(subject.plan, storey), layout="constrained")

    def frame(k: int) -> list[object]:
        figure.clear()
        ax = figure.add_subplot()
        place = subject.points[sources[k]]
        draw_field(
            ax, subject.plan, subject.points[level], place, levels[k], subject.spacing, storey, limits
        )
        ax.set_title(f"{subject.name}: level of a source at point {sources[k]}")
        return []

    animation = FuncAnimation(figure, frame, frames=len(sources))  # type: ignore[arg-type]
    animation.save(path, PillowWriter(fps=4), dpi=70)
    plt.close(figure)
    return len(sources)


def _of_a_pair(subject: Subject, what: What, source: int, listener: int) -> Figure:
    echogram = subject.echograms(source, np.array([listener]), _WALKS)[0]
    distance = float(np.linalg.norm(subject.points[source] - subject.points[listener]))
    title = f"{subject.name}: point {source} to {listener}, {distance:.1f} m"
    if what == "decay":
        figure, ax = plt.subplots(figsize=(7.0, 4.6), layout="constrained")
        draw_decay(ax, echogram)
        ax.set_title(title)
        return figure
    figure, axes = plt.subplots(3, 1, figsize=(7.5, 7.5), layout="constrained")
    ears = binaural_rir(ambisonic_rir(echogram, _RATE), _RATE)
    draw_waveform(axes[0], ears, _RATE)
    for ax, ear, name in zip(axes[1:], ears, ("left", "right"), strict=True):
        draw_spectrogram(ax, ear, _RATE)
        ax.set_title(f"{name} ear", fontsize=10)
    axes[0].set_title(f"{title}, facing +x")
    return figure


def _default_source(subject: Subject) -> int:
    nodes = subject.nodes if len(subject.nodes) else np.arange(len(subject.points))
    low, high = subject.points[:, :2].min(axis=0), subject.points[:, :2].max(axis=0)
    return int(
        nodes[np.linalg.norm(subject.points[nodes, :2] - (low + 0.25 * (high - low)), axis=1).argmin()]
    )


def _default_listeners(subject: Subject, source: int) -> list[int]:
    """The points at about a fifth and three fifths of the largest distance from the source, on its storey."""
    offset = subject.points - subject.points[source]
    same = np.abs(offset[:, 2]) < 0.1
    distance = np.where(same, np.linalg.norm(offset, axis=1), np.inf)
    largest = distance[np.isfinite(distance)].max()
    return [int(np.abs(distance - share * largest).argmin()) for share in (0.2, 0.6)]


def _storey(subject: Subject, height: float) -> int:
    levels = np.unique(np.round(subject.points[:, 2], 3))
    return min(int(np.searchsorted(levels, height - 0.1)), len(subject.plan.walls) - 1)


def _size(plan: FloorPlan, storey: int) -> tuple[float, float]:
    points = plan.walls[storey].reshape(-1, 2)
    if not len(points):
        return 8.0, 6.0
    width, depth = np.ptp(points, axis=0)
    across = 9.0
    return across, float(np.clip(across * depth / max(width, 0.1) + 0.9, 3.5, 12.0))
