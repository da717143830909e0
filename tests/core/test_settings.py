"""Settings in Python and in tables."""

from __future__ import annotations

from typing import Any

import pytest
from msgspec import structs

import soundspaces_sim as ss
from soundspaces_sim.core.config import as_config
from soundspaces_sim.core.numerics.reflection_laws import REFLECTION_LAWS
from soundspaces_sim.core.simulation_config import of_simulation, without_constants


def test_tables_and_switches() -> None:
    raw = {"walks": 64, "diffraction": False, "connections": {"subpaths": 8, "window": 0.03}}
    config = as_config({"simulation": raw}).simulation
    assert config == ss.SimulationConfig(
        walks=64,
        radiance_transfer=ss.RadianceTransferConfig(subpaths="shared"),
        diffraction=ss.DiffractionConfig(enabled=False),
        connections=ss.ConnectionsConfig(subpaths=8, window=0.03),
    )


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (
            {"reflection": "oblique"},
            "simulation.reflection: expected 'random' or 'angle', got 'oblique'",
        ),
        ({"scattering": 3}, "simulation.scattering: expected 'table' or 'size', got 3"),
        ({"denoise": "no"}, "simulation.denoise: expected True or False, got 'no'"),
        ({"denoise": 2}, "simulation.denoise: expected True or False, got 2"),
        ({"diffraction": {"enabled": "no"}}, "enabled"),
    ],
)
def test_a_choice_is_checked_in_python_too(given: dict[str, Any], message: str) -> None:
    with pytest.raises(ss.ConfigError, match=message):
        ss.SimulationConfig(**given)
    with pytest.raises(ss.ConfigError, match=next(iter(given))):
        as_config({"simulation": given})


@pytest.mark.parametrize(("counted", "law"), [(False, "angle"), (True, "random")])
def test_surfaces_absorb_by_angle_unless_reflections_are_counted(counted: bool, law: str) -> None:
    config = ss.SimulationConfig(materials=ss.MaterialsConfig(enabled=counted))
    assert (
        config.law == of_simulation(config).law == ss.JobConfig(simulation=config).simulation.law == law
    )
    later = structs.replace(ss.JobConfig().simulation, materials=config.materials)
    assert later.law == law  # counts may be asked for after a file is read
    for own in REFLECTION_LAWS:
        asked = ss.SimulationConfig(materials=config.materials, reflection=own)
        assert asked.law == of_simulation(asked).law == own


@pytest.mark.parametrize("law", REFLECTION_LAWS)
def test_every_reflection_law_may_be_a_jobs(law: str) -> None:
    assert ss.SimulationConfig(reflection=law).reflection == law
    assert as_config({"simulation": {"reflection": law}}).simulation.reflection == law


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"joined_walks": 3}, "simulation.joined_walks: there is no such setting"),
        ({"connections": {"subpath": 3}}, "simulation.connections.subpath: .* did you mean subpaths"),
        ({"connections": {"window": -1.0}}, "simulation.connections.window: expected 0 to 120 s"),
        (
            {"connections": {"window": float("nan")}},
            "simulation.connections.window: expected 0 to 120 s",
        ),
        ({"connections": {"subpaths": 1}}, "simulation.connections.subpaths: expected 0, or 2"),
        ({"diffraction": 3}, "simulation.diffraction: expected"),
        (
            {"receiver_volumes": {"radius_max": 2.0}},
            "simulation.receiver_volumes: there is no such setting",
        ),
    ],
)
def test_what_cannot_be_is_named(given: dict[str, Any], message: str) -> None:
    with pytest.raises(ss.ConfigError, match=message):
        as_config({"simulation": given})


def test_settings_that_are_constants_now_are_taken_out_of_files_where_they_have_their_values() -> None:
    stored = {
        "walks": 5,
        "least_distance": 0.05,
        "air_in_bands": "mean",
        "pressure_kpa": 101.325,
        "low": {"reactance": 0.0, "edge": 200.0},
        "connections": {"per_vertex": 1, "window": 0.1},
        "receiver_volumes": {"radius_min": 0.1, "radius_growth": 0.05, "radius_max": 1.0},
    }
    assert without_constants(stored) == {
        "walks": 5,
        "low": {"edge": 200.0},
        "connections": {"window": 0.1},
    }
    for other in (
        {"least_distance": 0.1},
        {"air_in_bands": "centre"},
        {"pressure_kpa": 83.0},
        {"low": {"reactance": -1.0}},
        {"connections": {"per_vertex": 2}},
        {"receiver_volumes": {"radius_max": 1.5}},
    ):
        assert without_constants(other) == other
    assert without_constants(None) is None
