"""Agents by name or checkpoint; PyTorch is imported when a trained one is loaded."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from soundspaces_agents import learn
from soundspaces_sim import ConfigError
from soundspaces_sim.parts import BASELINES, Agent, nearest_name as nearest


def load_agent(path: str | Path, device: str = "cpu") -> Agent:
    """A trained agent from its checkpoint. Raises `ConfigError`."""
    return learn.load_trained(Path(path), device)


def make_agent(name: str, what: str = "agent") -> tuple[Agent, tuple[str, ...], int]:
    """(agent, the sensors it needs, pixels of its depth pictures) of a baseline's name or a checkpoint's path.

    Raises `ConfigError`, which names `what`, for a name that is neither.
    """
    if name in BASELINES:
        return BASELINES[name](), ("intensity", "collision"), 128
    if not Path(name).exists():
        raise ConfigError(
            f"{what}: '{name}' is neither a checkpoint nor one of {', '.join(BASELINES)}{nearest(name, BASELINES)}"
        )
    agent: Any = load_agent(name)
    return agent, tuple(agent.policy.shapes), agent.policy.shapes.get("depth", (128,))[0]
