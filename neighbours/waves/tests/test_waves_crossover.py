"""Waves and echogram of one simulation as one response: one source strength, both ways, any tiles."""

from __future__ import annotations

import errno
import os
from itertools import product
from pathlib import Path
from unittest.mock import patch

import numpy as np
import pytest
import soundspaces_waves as sw
from soundspaces_waves.pairs import WaveRuns
from soundspaces_waves.solve import solve

import soundspaces_sim as ss
from soundspaces_sim.core.errors import ConfigError, SimulationError
from soundspaces_sim.transport.bsdf.impedance import impedance
from soundspaces_sim.transport.preparation import make_model
from soundspaces_sim.transport.simulate import simulate_pairs
from tests.rooms import box

WAVES = ss.LowConfig(method="waves")


def _images(size: np.ndarray, zeta: float, s: np.ndarray, l: np.ndarray, f: np.ndarray) -> np.ndarray:
    """(k,) response of a box with a rigid floor: images of up to three reflections, plane-wave coefficients."""
    out = np.zeros(len(f), complex)
    for n, u in product(product(range(-1, 2), repeat=3), product((0, 1), repeat=3)):
        low, high = (
            np.abs(np.subtract(n, u)),
            np.abs(n),
        )  # reflections at walls through 0, and opposite ones
        if (low + high).sum() > 3:
            continue
        away = (1 - 2 * np.array(u)) * s + 2 * np.array(n) * size - l
        r = np.linalg.norm(away)
        cos = np.abs(away) / r
        wall = (zeta * cos - 1.0) / (zeta * cos + 1.0)
        floor = np.array([wall[0], wall[1], 1.0])
        gain = np.prod(floor**low * wall**high)
        out += gain * np.exp(-2j * np.pi * f * r / 343.0) / (np.sqrt(4.0 * np.pi) * r)
    return out


def test_levels_are_continuous_in_a_large_absorbing_room() -> None:
    """9 x 8 x 6 m, floor rigid, all else absorbs 95 %: direct sound and the floor's image interfere across the edge.
    Within .3 dB per third from 63 to 800 Hz."""
    size = np.array([9.0, 8.0, 6.0])
    materials = ss.MaterialTable(
        ("floor", "dry"),
        np.array([125.0]),
        np.array([[0.0], [0.95]]),
        np.zeros((2, 1)),
        np.zeros((2, 1)),
    )
    room = box((9.0, 8.0, 6.0), materials, [1, 1, 1, 1, 0, 1])
    source = np.array([4.1, 3.7, 1.6])
    seats = np.array([[5.6, 4.3, 2.1], [4.6, 5.6, 1.9], [3.9, 4.2, 2.2]])
    config = ss.SimulationConfig(
        walks=160, duration=0.2, reflection="angle", scattering="table", air_absorption=False, low=WAVES
    )
    echoes = ss.simulate(room, source, seats, config)
    frequency = np.fft.rfftfreq(1 << 15, 1.0 / 16000)
    middles = 1000.0 * 10.0 ** (np.arange(-12, 0) / 10.0)
    for l, seat in enumerate(seats):
        found = np.fft.rfft(ss.ambisonic_rir(echoes[0, l], 16000)[0], 1 << 15)
        exact = _images(size, float(impedance(np.array(0.95))), source, seat, frequency)
        for middle in middles:
            band = (frequency >= middle * 10**-0.05) & (frequency < middle * 10**0.05)
            level = 10.0 * np.log10((np.abs(found[band]) ** 2).sum() / (np.abs(exact[band]) ** 2).sum())
            assert abs(level) < 0.3, (l, middle)


def _room(**settings: object) -> tuple[ss.Scene, np.ndarray, ss.SimulationConfig]:
    room = ss.shoebox((3.2, 2.7, 2.4), absorption=0.3, scattering=0.2)
    points = np.random.default_rng(1).uniform(0.1, 0.9, (6, 3)) * (3.2, 2.7, 2.4)
    low = ss.LowConfig(**{"method": "waves", "cells_per_wavelength": 8.0, **settings})  # type: ignore[arg-type]
    return room, points, ss.SimulationConfig(walks=32, duration=0.2, low=low)


def test_energies_are_those_without_waves() -> None:
    room, points, config = _room()
    plain = ss.SimulationConfig(walks=32, duration=0.2)
    with_waves, without = (ss.simulate(room, points[:2], points[2:], c) for c in (config, plain))
    np.testing.assert_array_equal(with_waves.energy, without.energy)
    np.testing.assert_array_equal(with_waves.direct_energy, without.direct_energy)
    assert without.low is None
    assert without[0, 0].low is None
    assert with_waves.low is not None
    alone = sw.simulate_low(room, points[:2], points[2:], 0.2, config, cells_per_wavelength=8.0)
    for s, l in np.ndindex(2, 4):
        found = with_waves[s, l].low
        assert found is not None
        np.testing.assert_array_equal(found.signal, alone[s, l].signal)


def test_runs_are_kept_and_reciprocal() -> None:
    """One run per point, whatever tiles it is in; pressures both ways are the same to the bit."""
    room, points, config = _room()
    model = make_model(room, points, config)
    whole, _ = simulate_pairs(model, points, None)
    runs = WaveRuns(model, points)
    a, b = points[:3], points[3:]
    with patch.object(runs, "_run", wraps=runs._run) as run:
        there, back = simulate_pairs(model, a, b, waves=runs)
        own, _ = simulate_pairs(model, a, None, waves=runs)
    asked = [call.args for call in run.call_args_list]
    np.testing.assert_array_equal(np.concatenate([sources for sources, _ in asked]), points)
    assert all(len(listeners) == 6 for _, listeners in asked)
    assert whole.low is not None
    assert there.low is not None
    assert back is not None
    assert back.low is not None
    assert own.low is not None
    np.testing.assert_array_equal(there.low, whole.low[:3, 3:])
    np.testing.assert_array_equal(back.low, whole.low[3:, :3])
    np.testing.assert_array_equal(own.low, whole.low[:3, :3])
    np.testing.assert_array_equal(whole.low[:, :, 0], whole.low[:, :, 0].transpose(1, 0, 2))


def test_where_the_disk_is_full_points_are_run_again(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """Room is asked for before a file is mapped."""
    room, points, config = _room()
    model = make_model(room, points, config)

    def full(*_: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr("soundspaces_waves.pairs.MEMORY", 0.0)
    assert isinstance(WaveRuns(model, points, tmp_path)._table, np.memmap)
    monkeypatch.setattr(os, "posix_fallocate", full)
    caplog.set_level("INFO")
    assert WaveRuns(model, points, tmp_path)._table is None and not list(tmp_path.iterdir())
    assert os.strerror(errno.ENOSPC) in caplog.text and "run again" in caplog.text


def test_pressures_that_are_not_reciprocal_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    room, points, config = _room()
    model = make_model(room, points, config)

    def broken(*given: object) -> np.ndarray:
        out = solve(*given)  # type: ignore[arg-type]
        out[0, 1] *= 1.01
        return out

    monkeypatch.setattr("soundspaces_waves.pairs.solve", broken)
    with pytest.raises(SimulationError, match="there and back differs"):
        simulate_pairs(model, points[:2], None)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"edge": 10.0}, "simulation.low.edge"),
        ({"edge": float("nan")}, "simulation.low.edge"),
        ({"cells_per_wavelength": 3.0}, "simulation.low.cells_per_wavelength"),
        ({"method": "fem"}, "simulation.low"),
    ],
)
def test_settings_out_of_range(given: dict[str, object], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        ss.LowConfig(**given)  # type: ignore[arg-type]


def test_bands_without_a_low_one_need_an_edge() -> None:
    with pytest.raises(ConfigError, match=r"simulation\.low\.edge"):
        ss.SimulationConfig(bands=(0.0, 5000.0, 20000.0), low=WAVES)
    ss.SimulationConfig(bands=(0.0, 5000.0, 20000.0), low=ss.LowConfig(method="waves", edge=150.0))


def test_too_many_cells_are_refused_before_any_is_made() -> None:
    hall = ss.shoebox((90.0, 60.0, 30.0))
    config = ss.SimulationConfig(duration=0.2, low=ss.LowConfig(method="waves", edge=900.0))
    with pytest.raises(SimulationError, match="cells of"):
        ss.simulate(hall, [1.0, 1.0, 1.0], [2.0, 2.0, 1.0], config)
