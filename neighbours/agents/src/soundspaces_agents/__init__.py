"""Agents that hear, trained and compared: the networks, learners, studies and pictures of the paper on SoundSpaces.

    from soundspaces_agents import load_agent
    agent = load_agent("out/nav/agents/AG-0/agent.pt")

Environments, episodes, sensors and measures are `soundspaces_sim.nav`. README.md has the studies.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
