"""Points and graphs as SoundSpaces 1 publishes them: `points.txt`; and `graph.pkl`, which a neighbour reads."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

import networkx
import numpy as np

from soundspaces_sim.core.errors import PointError
from soundspaces_sim.core.io.untrusted import read_text
from soundspaces_sim.core.registry import Entry, of_neighbour

#: Height of the camera above the floor of Habitat's agent, m: points lie so much above graph nodes.
HABITAT_HEIGHT = {"replica": 1.5528907, "mp3d": 1.5}

MOST_BYTES = 32 * 2**20  # of a file
_GRAPHS = Entry("soundspaces_exports.pickled:graph_points", "points of a pickled graph", "exports")


def read_points(path: str | Path) -> np.ndarray:
    """(N, 3) m from a text of lines ``x y z`` or ``idx x y z``, or a `graph.pkl` of SoundSpaces 1.

    Blanks, tabs, commas or semicolons lie between the numbers of a text; what follows a # is left out, and so is a
    first line of names. With indices, rows are in their order; they must be 0 to N - 1. A graph's points are those
    of its nodes, turned from Habitat's axes to Z up; they lie on the floor, as the file has them. Raises
    `PointError`.
    """
    path = Path(path)
    if path.suffix == ".pkl":
        array = of_neighbour(f"{path}: a graph of SoundSpaces 1", _GRAPHS)(path)
    else:
        array = _parse(path, read_text(path, PointError, "list of points", MOST_BYTES))
    if len(array) == 0 or not np.isfinite(array).all():
        raise PointError(f"{path}: expected at least one point, all finite")
    return array


def _parse(path: Path, text: str) -> np.ndarray:
    """(N, 3) m of a text as `read_points` has it."""
    rows: list[list[float]] = []
    first = True
    for number, line in enumerate(text.removeprefix("\ufeff").splitlines(), 1):
        fields = re.split(r"[,;\s]\s*", line.split("#")[0].strip())
        if fields == [""]:
            continue
        try:
            row = [float(field) for field in fields]
        except ValueError:
            if first and not any(map(_is_number, fields)):  # names of columns
                first = False
                continue
            row = []
        first = False
        if len(row) not in (3, 4) or not np.isfinite(row).all() or (rows and len(row) != len(rows[0])):
            wanted = (
                f"{len(rows[0])} finite numbers, as before"
                if rows
                else "`x y z` or `idx x y z`, finite numbers"
            )
            raise PointError(f"{path}, line {number}: expected {wanted}, got {line.strip()[:60]!r}")
        rows.append(row)
    table = np.array(rows, float)
    if not rows or table.shape[1] == 3:
        return table.reshape(-1, 3)
    if not np.array_equal(np.sort(table[:, 0]), np.arange(len(table))):
        raise PointError(
            f"{path}: expected indices 0 to {len(table) - 1}, each once, in the first of four columns; leave "
            "them out to have points in the order of lines"
        )
    return np.asarray(table[np.argsort(table[:, 0]), 1:])


def _is_number(field: str) -> bool:
    try:
        float(field)
    except ValueError:
        return False
    return True


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
