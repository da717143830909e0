"""Sources and listeners in, responses out: one run per source, `LANES` of them side by side, all listeners at
once."""

from __future__ import annotations

import numpy as np

from soundspaces_sim import SimulationError
from soundspaces_sim.parts import Air, check_interrupts as check, check_memory, over_rows, thread_count
from soundspaces_waves.placing import ROWS, place_points
from soundspaces_waves.row_algebra import LANES
from soundspaces_waves.scheme import WaveScene
from soundspaces_waves.spectrum import make_transform, pulse, record_steps, responses
from soundspaces_waves.stepping import Scheme, Taps, advance, still

_BLOCK = 200  # steps between looks for Ctrl-C

Placed = list[tuple[np.ndarray, np.ndarray]]


def solve(
    waves: WaveScene,
    sources: np.ndarray,
    listeners: np.ndarray,
    edge: float,
    duration: float,
    air: Air | None,
) -> np.ndarray:
    """(S, L, 4, n) float32: pressure and -rho c u along x, y, z at (L, 3) `listeners` from (S, 3) `sources`, in
    m.

    Raises `PointError` for points that no cell sees, `SimulationError` for responses that are not finite.
    """
    fed = place_points(waves.scene, waves.lattice, waves.component, sources, "sources")
    read = place_points(waves.scene, waves.lattice, waves.component, listeners, "listeners")
    airs = np.unique([waves.component[cells[0]] for cells, _ in fed])
    scheme = waves.scheme(airs)
    steps = record_steps(edge, duration, waves.step)
    signal = np.zeros(steps)
    signal[: len(pulse(edge, waves.step))] = pulse(edge, waves.step)
    transform = make_transform(edge, duration, steps, waves.step, waves.lattice.spacing, waves.c, air)
    taps = listener_taps(read)
    out = np.empty((len(sources), len(listeners), ROWS, transform.samples), np.float32)
    check_memory(thread_count() * _bytes(waves, steps, len(listeners)), "a run of waves")

    def run(first: int, last: int) -> None:
        for batch in range(first, last):
            rows = range(batch * LANES, min((batch + 1) * LANES, len(sources)))
            record = simulate(waves, scheme, [fed[s] for s in rows], taps, signal)
            for lane, s in enumerate(rows):
                out[s] = responses(transform, np.ascontiguousarray(record[:, :, lane]), waves.c)

    over_rows(run, -(-len(sources) // LANES), chunk=1)
    if not np.isfinite(out).all():
        s, l = np.argwhere(~np.isfinite(out).all(axis=(2, 3)))[0].tolist()
        raise SimulationError(
            f"{waves.scene.name}: waves: the response from source {s} to listener {l} is not finite; "
            f"please report it"
        )
    return out


def simulate(
    waves: WaveScene, scheme: Scheme, fed: Placed, read: Taps, signal: np.ndarray
) -> np.ndarray:
    """(steps, rows, LANES) record of taps, for up to `LANES` sources fed with `signal` (steps,)."""
    record = np.empty((len(signal), len(read.start) - 1, LANES), np.float32)
    field = still(waves.lattice.cells, scheme)
    feeds = _source_taps(waves, fed)
    for step in range(0, len(signal), _BLOCK):
        check()
        last = min(step + _BLOCK, len(signal))
        advance(step, last, scheme, field, feeds, signal, read, record)
    return record


def listener_taps(placed: Placed) -> Taps:
    """Four rows for each listener: pressure and derivatives."""
    cells = [cells for cells, weights in placed for _ in weights]
    return _taps(cells, [row for _, weights in placed for row in weights])


def _source_taps(waves: WaveScene, placed: Placed) -> Taps:
    """One row per lane. A volume source of strength s feeds p'' = c² s / (h³ V)."""
    h, cells = waves.lattice.spacing, [cells for cells, _ in placed]
    weights = [waves.courant**2 / h * w[0] / waves.volume[c] for c, w in placed]
    empty = LANES - len(placed)
    return _taps(cells + [np.empty(0, int)] * empty, weights + [np.empty(0)] * empty)


def _taps(cells: list[np.ndarray], weights: list[np.ndarray]) -> Taps:
    start = np.concatenate([[0], np.cumsum([len(c) for c in cells])]).astype(int)
    return Taps(start, np.concatenate(cells).astype(int), np.concatenate(weights).astype(float))


def _bytes(waves: WaveScene, steps: int, listeners: int) -> float:
    """Memory of a run of `LANES` sources."""
    return (
        4.0
        * LANES
        * (2.0 * waves.lattice.cells + 3.0 * len(waves.walls.cell) + ROWS * listeners * steps)
    )
