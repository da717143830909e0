"""Points and graphs as SoundSpaces 1 publishes them: `points.txt` and `graph.pkl`.

Files from strangers are data: the pickle is not unpickled, see `pickled`.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import networkx
import numpy as np

from soundspaces_sim.core.errors import PointError
from soundspaces_sim.core.io.untrusted import read_bytes, read_text
from soundspaces_sim.dataset.exporters.pickled import MOST_BYTES, PickleError, graph_of_pickle

#: Height of the camera above the floor of Habitat's agent, m: points lie so much above graph nodes.
HABITAT_HEIGHT = {"replica": 1.5528907, "mp3d": 1.5}


def read_points(path: str | Path) -> np.ndarray:
    """(N, 3) m from a `points.txt` (lines ``idx x y z``) or a `graph.pkl` of SoundSpaces 1.

    Rows are in order of the indices, which must be 0 to N - 1 in a points.txt. A graph's points are those
    of its nodes, turned from Habitat's axes to Z up; they lie on the floor, as the file has them. Raises
    `PointError`.
    """
    path = Path(path)
    if path.suffix == ".pkl":
        graph = read_graph(path)
        points = [graph.nodes[n].get("point") for n in sorted(graph.nodes)]
        try:
            array = np.array([(x, -z, y) for x, y, z in points], float).reshape(-1, 3)
        except (TypeError, ValueError, OverflowError) as error:
            raise PointError(
                f"{path}: nodes need an attribute `point` of three numbers ({error})"
            ) from error
    else:
        text = read_text(path, PointError, "list of points", MOST_BYTES)
        rows = [line.split() for line in text.splitlines() if line.strip()]
        try:
            table = np.array(rows, float)
        except ValueError as error:
            raise PointError(f"{path}: expected lines of `idx x y z`, numbers ({error})") from error
        if table.ndim != 2 or table.shape[1] != 4:
            raise PointError(f"{path}: expected lines of four numbers, `idx x y z`, at least one")
        if not np.array_equal(np.sort(table[:, 0]), np.arange(len(table))):
            raise PointError(f"{path}: expected indices 0 to {len(table) - 1}, each once")
        array = table[np.argsort(table[:, 0]), 1:]
    if len(array) == 0 or not np.isfinite(array).all():
        raise PointError(f"{path}: expected at least one point, all finite")
    return array


def read_graph(path: str | Path) -> networkx.Graph:
    """The graph of a `graph.pkl`. Raises `PointError` for anything that is not a plain networkx graph."""
    data = read_bytes(path, PointError, "graph", MOST_BYTES)
    try:
        return graph_of_pickle(data)
    except PickleError as error:
        raise PointError(f"{path}: not a pickled networkx graph ({error})") from error


def points_text(points: np.ndarray) -> str:
    """A `points.txt`: TAB-separated ``idx x y z``, without negative zeros."""
    rounded = np.round(points, 6) + 0.0
    return "".join(f"{i}\t{x:.6f}\t{y:.6f}\t{z:.6f}\n" for i, (x, y, z) in enumerate(rounded))


def habitat_point(point: Sequence[float], height: float) -> tuple[float, float, float]:
    """A point (x, y, z) m as the place on the floor below it in Habitat's frame: (x, z - height, -y)."""
    x, y, z = point
    return float(x), float(z - height) + 0.0, float(-y) + 0.0


def habitat_graph(graph: networkx.Graph, height: float) -> networkx.Graph:
    """A graph in Habitat's frame, (x, z - height, -y), with no attributes but `point`."""
    out = networkx.Graph()
    for n, data in graph.nodes(data=True):
        out.add_node(int(n), point=habitat_point(data["point"], height))
    out.add_edges_from((int(a), int(b)) for a, b in graph.edges)
    return out
