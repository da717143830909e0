"""What pictures are made of: a dataset, or a scene that is simulated for them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from soundspaces_sim import (
    Echogram,
    Grid,
    GridConfig,
    RirDataset,
    Scene,
    SimulationConfig,
    load_scene,
    make_graph,
    make_grid,
    open_dataset,
    simulate,
)
from soundspaces_sim.parts import (
    DEFAULT_WALKS,
    MANIFEST_NAME as NAME,
    FloorPlan,
    LowResponse,
    installed_low_method as installed,
    make_floorplan,
    read_floorplan,
    storeys_of,
)

LEVEL_WALKS = 250  # of a scene: enough for levels and directions
WAVES_S = 0.8  # s, of responses below the first band's edge
WALKS = DEFAULT_WALKS  # for decays, responses, and the error that a dataset would have


@dataclass(frozen=True)
class PlotData:
    """What pictures are made of: the plan, the points (N, 3) with the navigation graph, and echograms.

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
    parameter: str = "t30"  # of a map of one: a name of `dataset.room_parameters.registry.PARAMETERS`
    band_hz: float = 1000.0
    frequency_hz: float | None = None  # of a map of modes

    def echograms(self, source: int, listeners: np.ndarray, walks: int = LEVEL_WALKS) -> list[Echogram]:
        """From the dataset, or simulated with so many subpaths."""
        if self.path is not None:
            with open_dataset(self.path) as ds:
                return [ds.echogram(source, int(l)) for l in listeners]
        assert self.scene is not None
        scene = self.scene
        echoes = simulate(
            scene, self.points[[source]], self.points[listeners], SimulationConfig(walks=walks)
        )
        return [echoes[0, i] for i in range(len(listeners))]

    def waves(self, source: int, listeners: np.ndarray) -> list[LowResponse]:
        """From the dataset, or simulated. Raises `DatasetError` for a dataset without waves."""
        if self.path is not None:
            with open_dataset(self.path) as ds:
                return [ds.low(source, int(l)) for l in listeners]
        assert self.scene is not None
        method = installed("waves")
        return method.responses_from(self.scene, self.points[source], self.points[listeners], WAVES_S)


def load_plot_data(source: str | Path, spacing: float | None = None) -> PlotData:
    """A dataset folder, or anything `load_scene` takes. Raises the errors of either."""
    path = Path(source)
    if (path / NAME).is_file():
        with open_dataset(path) as ds:
            return dataset_subject(ds)
    scene = load_scene(source)
    grid = make_grid(scene, config=GridConfig(spacing=spacing or 0.5))
    graph = make_graph(scene, grid)
    return PlotData(
        scene.name,
        make_floorplan(scene, grid),
        grid,
        grid.points,
        graph.nodes,
        graph.edges,
        grid.spacing,
        None,
        scene,
    )


def dataset_subject(ds: RirDataset) -> PlotData:
    """An open dataset. Raises `DatasetError` if its floor plan cannot be read."""
    found = ds.manifest
    edges = np.array(found.edges, int).reshape(-1, 2)
    return PlotData(
        ds.scene,
        read_floorplan(ds.path),
        None,
        ds.points,
        np.array(found.nodes, int),
        edges,
        found.config.grid.spacing,
        ds.path,
        None,
    )


def default_source(data: PlotData) -> int:
    """The point nearest to a quarter of the plan."""
    nodes = data.nodes if len(data.nodes) else np.arange(len(data.points))
    low, high = data.points[:, :2].min(axis=0), data.points[:, :2].max(axis=0)
    return int(
        nodes[np.linalg.norm(data.points[nodes, :2] - (low + 0.25 * (high - low)), axis=1).argmin()]
    )


def default_listeners(data: PlotData, source: int) -> list[int]:
    """The points at about a fifth and three fifths of the largest distance from the source, on its storey."""
    distance = np.full(len(data.points), np.inf)
    _, same = on_storey(data, source)
    distance[same] = np.linalg.norm(data.points[same] - data.points[source], axis=1)
    largest = distance[np.isfinite(distance)].max()
    return [int(np.abs(distance - share * largest).argmin()) for share in (0.2, 0.6)]


def storeys_in(data: PlotData) -> np.ndarray:
    """(N,) the storey of every point."""
    return storeys_of(data.plan, data.points)


def on_storey(data: PlotData, point: int) -> tuple[int, np.ndarray]:
    """The storey of a point, and the points on it."""
    storey = storeys_in(data)
    return int(storey[point]), np.flatnonzero(storey == storey[point])
