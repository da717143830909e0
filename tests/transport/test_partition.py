"""The weights of all techniques that can make one path sum to one, delta lobes included."""

from typing import Any

import numpy as np
import pytest

from soundspaces_sim.scene.rays.directions import INV_PI
from soundspaces_sim.transport.paths import mis as parts


class mis:  # noqa: N801
    """The functions of `mis` as Python calls them."""

    start, arrive = parts.start.py_func, parts.arrive.py_func
    leave_scatter, leave_delta = parts.leave_scatter.py_func, parts.leave_delta.py_func
    weight_receiver_volume = parts.weight_receiver_volume.py_func
    weight_vertex_to_point = parts.weight_vertex_to_point.py_func
    connection_term, weight_vertex_to_vertex = (
        parts.connection_term.py_func,
        parts.weight_vertex_to_vertex.py_func,
    )


class _Path:
    """A random path p - x_1 … x_k - q: only the numbers that the weights depend on."""

    def __init__(self, rng: np.random.Generator, diffuse: list[bool]) -> None:
        self.diffuse = np.array(diffuse)
        k = len(diffuse)
        self.legs = rng.uniform(0.3, 6.0, k + 1)
        self.cos_in = rng.uniform(0.05, 1.0, k)
        self.cos_out = np.where(self.diffuse, rng.uniform(0.05, 1.0, k), self.cos_in)
        self.p = rng.uniform(0.05, 0.9, k)
        self.eta = rng.uniform(0.01, 3.0, 2)  # of p's and of q's detector

    def reversed(self) -> "_Path":
        other = object.__new__(_Path)
        other.diffuse, other.legs, other.p = self.diffuse[::-1], self.legs[::-1], self.p[::-1]
        other.cos_in, other.cos_out = self.cos_out[::-1], self.cos_in[::-1]
        other.eta = self.eta[::-1]
        return other

    def arrivals(self, kappa: float, vv: float) -> tuple[list[Any], Any]:
        """MIS state on arrival at each vertex, and after leaving the last one."""
        state, arrived = mis.start(kappa), []
        for i in range(len(self.p)):
            state = mis.arrive(state, self.legs[i], self.cos_in[i], 1.0 if i == 0 else vv)
            arrived.append(state)
            if self.diffuse[i]:
                forward, reverse = (
                    self.p[i] * self.cos_out[i] / np.pi,
                    self.p[i] * self.cos_in[i] / np.pi,
                )
                state = mis.leave_scatter(state, forward, reverse, self.cos_out[i])
            else:
                state = mis.leave_delta(state, self.cos_in[i])
        return arrived, state


def _ends(path: _Path, kappa: float, vv: float) -> float:
    """Weights of the two techniques that close the path at q: a receiver volume, and a connection of the last
    vertex."""
    arrived, left = path.arrivals(kappa, vv)
    r2, cos, p = path.legs[-1] ** 2, path.cos_out[-1], path.p[-1]
    vertex_term = r2 * np.pi / (p * cos) if path.diffuse[-1] else 0.0
    total = mis.weight_receiver_volume(left, vertex_term, path.eta[0], path.eta[1], kappa, True)
    if path.diffuse[-1]:
        total += mis.weight_vertex_to_point(
            arrived[-1],
            parts.Closing(p * cos / np.pi, p * path.cos_in[-1] / np.pi, cos, r2),
            path.eta[0],
            path.eta[1],
            kappa,
        )
    return float(total)


def _inner(path: _Path, kappa: float, vv: float) -> float:
    """Weights of all connections of a vertex to a vertex."""
    forward, _ = path.arrivals(kappa, vv)
    backward, _ = path.reversed().arrivals(kappa, vv)
    total, k = 0.0, len(path.p)
    for i in range(k - 1):
        if not (path.diffuse[i] and path.diffuse[i + 1]):
            continue
        geometric = path.cos_out[i] * path.cos_in[i + 1] / path.legs[i + 1] ** 2
        x, y = forward[i], backward[k - 2 - i]
        term_x = mis.connection_term(
            x, path.p[i] * path.cos_in[i] * INV_PI, path.eta[0], path.p[i + 1] * INV_PI * geometric
        )
        term_y = mis.connection_term(
            y, path.p[i + 1] * path.cos_out[i + 1] * INV_PI, path.eta[1], path.p[i] * INV_PI * geometric
        )
        total += mis.weight_vertex_to_vertex(term_x, term_y, vv)
    return float(total)


@pytest.mark.parametrize(
    "lobes", ["D", "S", "DD", "SS", "DS", "SD", "DDD", "DSD", "SDS", "DDSDD", "SDDDSSDD"]
)
def test_weights_sum_to_one(lobes: str) -> None:
    rng = np.random.default_rng(sum(map(ord, lobes)))
    for _ in range(50):
        path = _Path(rng, [c == "D" for c in lobes])
        kappa, vv = rng.uniform(1.0, 200.0), rng.uniform(0.05, 2.0)
        total = _ends(path, kappa, vv) + _ends(path.reversed(), kappa, vv) + _inner(path, kappa, vv)
        assert total == pytest.approx(1.0, abs=1e-12)


def test_beyond_the_connection_window_receiver_volumes_share_alone() -> None:
    """Connections have count zero there: the two receiver volumes' weights are eta / (eta_p + eta_q)."""
    rng = np.random.default_rng(5)
    path = _Path(rng, [True, False, True])
    weights = []
    for way in (path, path.reversed()):
        _, left = way.arrivals(80.0, 0.1)
        weights.append(mis.weight_receiver_volume(left, 1.0, way.eta[0], way.eta[1], 80.0, False))
        assert weights[-1] == pytest.approx(way.eta[1] / way.eta.sum(), abs=1e-12)
    assert sum(weights) == pytest.approx(1.0, abs=1e-12)
