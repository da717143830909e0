"""How far values of seeds lie apart, over the errors that are stated: the table of docs/validation.md.

    python -m tests.transport.error_table home-7001 --walks 3000 --seeds 12

A source and four listeners over a building's grid. Discrete arrivals have no error, and are those of the first
seed: z is of what subpaths make.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import replace
from typing import Literal

import numpy as np

import soundspaces_sim as ss
from soundspaces_sim.core.errors import ConfigError
from soundspaces_sim.echogram.echogram import Echograms
from soundspaces_sim.echogram.measure_errors import measure_values
from soundspaces_sim.echogram.measure_names import MEASURES
from soundspaces_sim.scene.load import load_scene
from soundspaces_sim.transport.integrator import run_techniques, traced
from soundspaces_sim.transport.model import EARLY_S
from soundspaces_sim.transport.simulate import model_between
from soundspaces_sim.transport.smoothing import smoothed
from soundspaces_sim.transport.technique import Technique
from soundspaces_sim.transport.techniques import TECHNIQUES

_Kind = Literal["shared", "own", "auto"]
LISTENERS = 4
NAMES = ("early", "late", "t20", "t30", "edt", "c80", "d50")
_MOST_UNKNOWN = 0.5  # of the seeds: a pair's band counts if its error is known in more


def _runs(name: str, walks: int, seeds: int, subpaths: _Kind) -> Iterator[Echograms]:
    scene = load_scene(name)
    points = ss.make_grid(scene).points
    points = points[np.linspace(0, len(points) - 1, LISTENERS + 1).astype(int)]
    a, b = points[:1], points[1:]
    config = ss.SimulationConfig(
        walks=walks, radiance_transfer=ss.RadianceTransferConfig(subpaths=subpaths)
    )
    model, arrived = model_between(scene, a, b, config, 0), None
    techniques: tuple[Technique, ...] = TECHNIQUES
    for seed in range(seeds):
        of_seed = replace(model, seed=seed) if seed else model
        try:
            made = run_techniques(of_seed, a, b, False, techniques=techniques)
        except (
            ConfigError
        ):  # `own` refuses a seed whose late energies would drown others: no value, no error
            continue
        if arrived is None:
            arrived = made.arrived
            techniques = tuple(t for t in TECHNIQUES if t.connect is None)
        yield smoothed(of_seed, traced(made._replace(arrived=arrived), False))[0]


def _values(echoes: Echograms) -> tuple[np.ndarray, np.ndarray]:
    """(7, L, b) values, and their errors: of energies, relative ones."""
    assert echoes.measure_error is not None
    edges = echoes.time_edges
    split = echoes.direct_length[0] / echoes.speed_of_sound + EARLY_S
    late = np.clip((edges[1:] - split[:, None]) / np.diff(edges), 0.0, 1.0)
    energy = np.einsum(
        "wlt,ltb->wlb", np.stack([1.0 - late, late]), echoes.energy[0, :, :, 0].astype(float)
    )
    energy[0] += echoes.direct_energy[0]
    for l in range(LISTENERS):
        for arrival in echoes[0, l].arrivals:
            energy[int(arrival.delay > split[l]), l] += arrival.energy
    chosen = [MEASURES.index(name) for name in NAMES[2:]]
    values = measure_values(echoes)[0][:, chosen].swapaxes(0, 1)
    errors = echoes.measure_error[0][:, chosen].swapaxes(0, 1)
    relative = echoes.relative_error[0].swapaxes(0, 1)
    return np.concatenate([energy, values]), np.concatenate([relative, errors]).astype(float)


def spreads(name: str, walks: int, seeds: int, subpaths: _Kind = "own") -> tuple[np.ndarray, np.ndarray]:
    """(7, b) root mean square of z, and the share of pairs that counts, NaN and 0 where none does."""
    values, errors = (
        np.array(x) for x in zip(*map(_values, _runs(name, walks, seeds, subpaths)), strict=True)
    )
    n = len(values)
    errors[:, :2] *= values.mean(axis=0)[:2]
    known = np.isfinite(errors) & np.isfinite(values)
    counted = known.mean(axis=0) > _MOST_UNKNOWN
    known &= counted
    mean = np.nanmean(values, axis=0)
    z = np.divide(values - mean, errors, out=np.zeros_like(values), where=known)
    number = known.sum(axis=(0, 2))
    squares = np.square(z).sum(axis=(0, 2)) * n / (n - 1)
    mean_square = np.divide(squares, number, out=np.full(squares.shape, np.nan), where=number > 0)
    return np.sqrt(mean_square), counted.mean(axis=1)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="+")
    parser.add_argument("--walks", type=int, default=3000)
    parser.add_argument("--seeds", type=int, default=12)
    parser.add_argument("--subpaths", default="own")
    args = parser.parse_args()
    for name in args.names:
        found, counted = spreads(name, args.walks, args.seeds, args.subpaths)
        print(f"{name}, {args.walks}, {args.subpaths}, {args.seeds} seeds", flush=True)
        for what, row, share in zip(NAMES, found, counted, strict=True):
            print(
                f"| {what} | {' '.join(f'{x:.2f}' for x in row)} | {' '.join(f'{100 * x:.0f}' for x in share)} % |"
            )


if __name__ == "__main__":
    main()
