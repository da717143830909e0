"""The time loop. Rows hold `LANES` sources (`row_algebra`); cells are visited in the order of their numbers.

Pressures are kept as p and its last increment e, which loses far fewer digits than two pressures: at low
frequencies increments are small. A branch keeps its velocity u, the force of its mass a and of its stiffness b
(trapezoidal rule, implicit in its own cell's pressure); a layer, between two cells, its velocity.

Where no wall lets a steady flow through, what rounding adds to the volume flow would raise the pressure for
ever. There the increments are kept at the flow of the source, which the scheme conserves (equation T57).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from soundspaces_sim.parts import kernel, kernel_part as part
from soundspaces_waves.row_algebra import (
    FOUR,
    LANES,
    add_differences,
    add_differences_of_four,
    add_in_double,
    add_scaled,
    move_branch,
    push_branch,
    set_scaled,
)

_HELD_EVERY = 8  # steps between corrections of sealed airs where nothing is fed: every step costs more


class Stencil(NamedTuple):
    """courant² A / V: cells of one kind have the same row of offsets and weights."""

    cell: np.ndarray  # (n,) cells that take part
    kind: np.ndarray  # (n,)
    alike: (
        np.ndarray
    )  # (n,) whether the cell and the three after it are of one kind, with numbers in a row
    start: np.ndarray  # (kinds + 1,) into offset and weight
    offset: np.ndarray  # int32, of the neighbours' numbers
    weight: np.ndarray  # float32


class Walls(NamedTuple):
    """Cells beside walls that absorb, and their branches; of a branch D = R + 2 m / T + k T / 2."""

    cell: np.ndarray  # (n,)
    start: np.ndarray  # (n + 1,) into the branches
    damping: np.ndarray  # (n,) 1 / (1 + sum of share * gain / 2)
    share: np.ndarray  # (b,) courant S / V
    gain: np.ndarray  # (b,) 1 / D
    mass: np.ndarray  # (b,) 4 m / T
    stiffness: np.ndarray  # (b,) k T


class Layers(NamedTuple):
    """Links with a resistance or a mass of their own, m / T in all: layers that hang free, limp walls."""

    near: np.ndarray  # (n,) cells
    far: np.ndarray  # (n,)
    share: np.ndarray  # (n, 2) courant S / V of both
    gain: np.ndarray  # (n,) 1 / (m / T + r / 2)
    resistance: np.ndarray  # (n,)


class Sealed(NamedTuple):
    """Airs all of whose walls are rigid or springs: no steady flow leaves them."""

    air: np.ndarray  # (cells,) which of them a cell belongs to, -1 for none
    volume: np.ndarray  # (cells,) over h³
    whole: np.ndarray  # (airs,) volume


class Field(NamedTuple):
    """What changes; rows of `LANES` float32."""

    p: np.ndarray  # (cells, LANES)
    e: np.ndarray  # (cells, LANES) p less the one before
    u: np.ndarray  # (b, LANES)
    a: np.ndarray  # (b, LANES)
    b: np.ndarray  # (b, LANES)
    v: np.ndarray  # (layers, LANES)
    work: np.ndarray  # (1, LANES)
    change: np.ndarray  # (airs, LANES) of sealed airs
    excess: np.ndarray  # (airs, LANES) float64


class Taps(NamedTuple):
    """Sums over cells: where lanes are fed (one row per lane) and where the field is read."""

    start: np.ndarray  # (rows + 1,)
    cell: np.ndarray
    weight: np.ndarray


class Scheme(NamedTuple):
    stencil: Stencil
    walls: Walls
    layers: Layers
    sealed: Sealed


def still(cells: int, scheme: Scheme) -> Field:
    """A field at rest."""
    airs = len(scheme.sealed.whole)
    sizes = cells, cells, *(len(scheme.walls.share),) * 3, len(scheme.layers.near), 1, airs
    return Field(*(np.zeros((n, LANES), np.float32) for n in sizes), np.zeros((airs, LANES)))


@part
def _read(out: np.ndarray, taps: Taps, p: np.ndarray) -> None:
    """Rows of `out`: sums of the pressure, after this instant."""
    for r in range(len(taps.start) - 1):
        set_scaled(out, r, 0.0, p, 0)
        for k in range(taps.start[r], taps.start[r + 1]):
            add_scaled(out, r, taps.weight[k], p, taps.cell[k])


@part
def _through_air(field: Field, stencil: Stencil) -> None:
    start, n = stencil.start, 0
    while n < len(stencil.cell):
        span, cell = (start[stencil.kind[n]], start[stencil.kind[n] + 1]), stencil.cell[n]
        if stencil.alike[n]:
            add_differences_of_four(field.e, field.p, cell, stencil.offset, stencil.weight, span)
            n += FOUR
        else:
            add_differences(field.e, field.p, cell, stencil.offset, stencil.weight, span)
            n += 1


@part
def _through_layers(field: Field, layers: Layers) -> None:
    work = field.work
    for k in range(len(layers.near)):
        i, j = layers.near[k], layers.far[k]
        gain = layers.gain[k]
        set_scaled(work, 0, gain, field.p, i)
        add_scaled(work, 0, -gain, field.p, j)
        add_scaled(work, 0, -gain * layers.resistance[k], field.v, k)
        add_scaled(field.v, k, 1.0, work, 0)
        add_scaled(field.e, i, -layers.share[k, 0], work, 0)
        add_scaled(field.e, j, layers.share[k, 1], work, 0)


@part
def _at_walls(field: Field, walls: Walls) -> None:
    branch = (field.u, field.a, field.b)
    for n in range(len(walls.cell)):
        i = walls.cell[n]
        for k in range(walls.start[n], walls.start[n + 1]):
            share = walls.share[k]
            push_branch(field.e, field.p, i, branch, k, share, share * walls.gain[k])
        set_scaled(field.e, i, walls.damping[n], field.e, i)
        for k in range(walls.start[n], walls.start[n + 1]):
            forces = (walls.mass[k], walls.stiffness[k])
            move_branch(branch, k, field.e, field.p, i, walls.gain[k], forces)


@part
def _find_excess(field: Field, scheme: Scheme, fed: Taps, emitted: float) -> None:
    """Volume flow of sealed airs, over h³, beyond what their sources have `emitted`."""
    excess, walls, (air, volume, _) = field.excess, scheme.walls, scheme.sealed
    excess[:] = 0.0
    for i in scheme.stencil.cell:
        if air[i] >= 0:
            add_in_double(excess, air[i], volume[i], field.e, i)
    for n in range(len(walls.cell)):
        i = walls.cell[n]
        if air[i] >= 0:
            for k in range(walls.start[n], walls.start[n + 1]):
                add_in_double(excess, air[i], volume[i] * walls.share[k], field.u, k)
    for lane in range(LANES):
        for k in range(fed.start[lane], fed.start[lane + 1]):
            i = fed.cell[k]
            if air[i] >= 0:
                excess[air[i], lane] -= volume[i] * fed.weight[k] * emitted


@part
def _conserve_flow(field: Field, scheme: Scheme, fed: Taps, emitted: float) -> None:
    """Take the excess of sealed airs off their increments, and off the pressures that these led to."""
    _find_excess(field, scheme, fed, emitted)
    air, _, whole = scheme.sealed
    for a in range(len(whole)):
        for lane in range(LANES):
            field.change[a, lane] = np.float32(-field.excess[a, lane] / whole[a])
    for i in scheme.stencil.cell:
        if air[i] >= 0:
            add_scaled(field.e, i, 1.0, field.change, air[i])
            add_scaled(field.p, i, 1.0, field.change, air[i])


class _Run(NamedTuple):
    """What `advance` is given but for the steps."""

    scheme: Scheme
    field: Field
    fed: Taps
    signal: np.ndarray
    read: Taps
    out: np.ndarray


@part
def _advance(first: int, last: int, run: _Run) -> None:
    scheme, field, fed, signal, read, out = run
    cell = scheme.stencil.cell
    for step in range(first, last):
        _read(out[step], read, field.p)
        _through_air(field, scheme.stencil)
        for lane in range(LANES):
            for k in range(fed.start[lane], fed.start[lane + 1]):
                field.e[fed.cell[k], lane] += np.float32(fed.weight[k] * signal[step])
        _through_layers(field, scheme.layers)
        _at_walls(field, scheme.walls)
        for n in range(len(cell)):
            add_scaled(field.p, cell[n], 1.0, field.e, cell[n])


@kernel
def _advance_leaking(first: int, last: int, run: _Run) -> None:
    _advance(first, last, run)


@kernel
def _advance_sealed(first: int, last: int, run: _Run) -> None:
    signal = run.signal
    step, emitted = first, signal[:first].sum()
    while step < last:
        is_fed = signal[step] != 0.0
        end = min(step + 1 if is_fed else step - step % _HELD_EVERY + _HELD_EVERY, last)
        _advance(step, end, run)
        emitted += signal[step:end].sum()
        if is_fed or end % _HELD_EVERY == 0:
            _conserve_flow(run.field, run.scheme, run.fed, emitted)
        step = end


def advance(
    first: int,
    last: int,
    scheme: Scheme,
    field: Field,
    fed: Taps,
    signal: np.ndarray,
    read: Taps,
    out: np.ndarray,
) -> None:
    """Steps `first` to `last`: `out` (steps, rows, LANES) takes the field at each, then `signal` (steps,) is
    fed."""
    # two kernels, as a test inside of one takes 3 % of the time
    one = _advance_sealed if len(scheme.sealed.whole) else _advance_leaking
    one(first, last, _Run(scheme, field, fed, signal, read, out))
