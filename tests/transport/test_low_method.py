"""Waves where nothing that simulates them is installed: one error that says how to get it, before anything is made."""

from __future__ import annotations

from typing import Any

import pytest

import soundspaces_sim as ss


def test_waves_name_their_neighbour(monkeypatch: pytest.MonkeyPatch) -> None:
    def none(**_: Any) -> tuple[()]:
        return ()

    monkeypatch.setattr("soundspaces_sim.core.registry.entry_points", none)
    config = ss.SimulationConfig(walks=8, duration=0.1, low=ss.LowConfig(method="waves"))
    with pytest.raises(ss.ConfigError, match=r"pip install .*\./neighbours/waves"):
        ss.simulate(ss.shoebox((4.0, 3.0, 2.5)), [1.0, 1.0, 1.0], [[2.0, 2.0, 1.0]], config)
