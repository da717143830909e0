"""`Context`: objects, sources and listeners in, impulse responses out."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field

import numpy as np

from soundspaces_rlr.arguments import (
    check_reach,
    check_room,
    length,
    orthonormal,
    pick,
    rotation,
    vector3,
)
from soundspaces_rlr.builder import SceneBuilder
from soundspaces_rlr.errors import as_runtime_errors
from soundspaces_rlr.propagation import Group, group_listeners, noise_seeds, threads
from soundspaces_rlr.records import ChannelLayout, Config, check_config
from soundspaces_rlr.render import GroupListener, render_group, response_samples
from soundspaces_rlr.results import Results
from soundspaces_sim.parts import check_rate
from soundspaces_sim.rendering import load_hrtf

_DEFAULT_RADIUS = 0.1  # m


@dataclass
class _Source:
    position: np.ndarray = field(default_factory=lambda: np.zeros(3))
    radius: float = _DEFAULT_RADIUS


@dataclass
class _Listener:
    layout: ChannelLayout
    position: np.ndarray = field(default_factory=lambda: np.zeros(3))
    turn: np.ndarray = field(default_factory=lambda: np.eye(3))  # local to world
    radius: float = _DEFAULT_RADIUS
    hrtf: str | None = None


class Context(SceneBuilder, Results):
    """A simulation of sound from sources to listeners among objects, with the methods of
    `rlr_audio_propagation.Context`.

    Positions are in units of `config.unit_scale` m, in any right-handed axes; a head without orientation
    has the axes `config.hrtf_right`, `hrtf_up` and `hrtf_back`. `simulate` traces; the `get_…` methods
    give what it left: 1-D float64 responses whose direct sound is sqrt(1 / (4 pi)) / r. The same calls
    give the same bits. Methods raise `RlrError` (a RuntimeError) that says what is wrong, TypeError for
    arguments of a wrong kind.
    """

    def __init__(self, config: Config) -> None:
        SceneBuilder.__init__(self, _checked(config, "Context"))
        Results.__init__(self)
        self._forget_ends()

    def _forget_ends(self) -> None:
        self._sources: list[_Source] = []
        self._listeners: list[_Listener] = []
        self._responses, self._efficiency = [], 0.0

    def reset(self, config: Config | None = None) -> None:
        """Forget objects, materials, sources, listeners and results; take another config if one is given."""
        if config is not None:
            self.config = _checked(config, "reset")
        self._forget_scene()
        self._forget_ends()

    @property
    def sr(self) -> float:
        """Sample rate of the responses, Hz."""
        return self.config.sample_rate

    # --- sources -------------------------------------------------------------------------------------

    def add_source(self) -> None:
        """Add a source at the origin; its index is the number of those before it."""
        self._sources.append(_Source())

    def clear_sources(self) -> None:
        """Remove all sources, and what was simulated."""
        self._sources, self._responses = [], []

    def get_source_count(self) -> int:
        """Number of sources."""
        return len(self._sources)

    def set_source_position(self, source_index: int, position: Sequence[float]) -> None:
        """Put a source at a position (3,)."""
        source = pick(self._sources, source_index, "source")
        source.position = np.array(vector3(position, "set_source_position"))

    def set_source_radius(self, source_index: int, radius: float) -> None:
        """Radius of a source; kept, without effect: sources are points."""
        pick(self._sources, source_index, "source").radius = length(radius, "set_source_radius")

    # --- listeners -----------------------------------------------------------------------------------

    def add_listener(self, channel_layout: ChannelLayout) -> None:
        """Add a listener at the origin."""
        if not isinstance(channel_layout, ChannelLayout):
            raise TypeError(
                f"add_listener: expected a ChannelLayout, got {type(channel_layout).__name__}"
            )
        layout = ChannelLayout(channel_layout.type, channel_layout.channel_count)
        _ = layout.channels  # a layout that cannot be heard with is refused here
        self._listeners.append(_Listener(layout))

    def clear_listeners(self) -> None:
        """Remove all listeners, and what was simulated."""
        self._listeners, self._responses = [], []

    def get_listener_count(self) -> int:
        """Number of listeners."""
        return len(self._listeners)

    def set_listener_position(self, listener_index: int, position: Sequence[float]) -> None:
        """Put a listener at a position (3,)."""
        listener = pick(self._listeners, listener_index, "listener")
        listener.position = np.array(vector3(position, "set_listener_position"))

    def set_listener_orientation_quaternion(
        self, listener_index: int, orientation: Sequence[float]
    ) -> None:
        """Turn a listener's head by [w, x, y, z], local to world. Ambisonics stay in world axes."""
        listener = pick(self._listeners, listener_index, "listener")
        listener.turn = rotation(orientation, "set_listener_orientation_quaternion")

    def set_listener_radius(self, listener_index: int, radius: float) -> None:
        """Radius of a listener; kept, without effect: listeners are points."""
        pick(self._listeners, listener_index, "listener").radius = length(radius, "set_listener_radius")

    def set_listener_hrtf(self, listener_index: int, hrtf_file_path: str) -> None:
        """HRTF of a binaural listener, a SOFA file (SimpleFreeFieldHRIR); the default is MIT's KEMAR."""
        listener = pick(self._listeners, listener_index, "listener")
        with as_runtime_errors():
            load_hrtf(str(hrtf_file_path))
        listener.hrtf = str(hrtf_file_path)

    # --- simulation ----------------------------------------------------------------------------------

    def simulate(self) -> None:
        """Simulate every source at every listener. Without either there is nothing to do."""
        self._responses, self._efficiency = [], 0.0
        if not self._sources or not self._listeners:
            return
        check_config(self.config)
        unit = self.config.unit_scale
        sources = unit * np.array([s.position for s in self._sources]) + 0.0
        listeners = unit * np.array([l.position for l in self._listeners]) + 0.0
        check_reach(sources, "source")
        check_reach(listeners, "listener")
        groups = group_listeners(listeners)
        with as_runtime_errors(), threads(self.config.thread_count) as workers:
            check_rate(self.config.sample_rate, "Config.sample_rate")
            channels = [listener.layout.channels for listener in self._listeners]
            propagation = self._scene()
            places = np.ascontiguousarray(listeners[[g.place for g in groups]])
            table = propagation.echograms(sources, places, self.config)
            if self.config.indirect:
                self._efficiency = propagation.efficiency(np.unique(places, axis=0))
            longest = max(response_samples(echogram, self.config) for row in table for echogram in row)
            check_room(len(sources) * sum(channels) * longest)
            jobs = [(s, g) for s in range(len(sources)) for g in range(len(groups))]
            seeds = noise_seeds(sources, places, bool(self.config.temporal_coherence))

            def render(job: tuple[int, int]) -> list[np.ndarray]:
                s, g = job
                ears = [self._ears(i, listeners[i] - places[g]) for i in groups[g].members]
                distance = np.linalg.norm(listeners[list(groups[g].members)] - sources[s], axis=1)
                return render_group(table[s][g], ears, distance.tolist(), self.config, int(seeds[s, g]))

            with ThreadPoolExecutor(workers) as pool:
                rendered = list(pool.map(render, jobs))
        self._responses = _by_listener(jobs, rendered, groups, len(sources), len(listeners))

    def _ears(self, index: int, offset: np.ndarray) -> GroupListener:
        listener, config = self._listeners[index], self.config
        axes = np.array(
            [np.negative(config.hrtf_back), np.negative(config.hrtf_right), np.asarray(config.hrtf_up)]
        ).T
        return GroupListener(offset, listener.layout, listener.turn @ orthonormal(axes), listener.hrtf)

    def places(self, listener_index: int, source_index: int) -> tuple[np.ndarray, np.ndarray]:
        """(3,) positions of a listener and a source, in units of `config.unit_scale`; not of the original."""
        listener = pick(self._listeners, listener_index, "listener")
        source = pick(self._sources, source_index, "source")
        return np.array(listener.position), np.array(source.position)

    def get_indirect_ray_efficiency(self) -> float:
        """Share of rays from the listeners that do not escape from the scene, 0 to 1."""
        return self._efficiency


def _checked(config: object, what: str) -> Config:
    if not isinstance(config, Config):
        raise TypeError(f"{what}: expected a Config, got {type(config).__name__}")
    return config


def _by_listener(
    jobs: list[tuple[int, int]],
    rendered: list[list[np.ndarray]],
    groups: list[Group],
    sources: int,
    listeners: int,
) -> list[list[np.ndarray]]:
    """Responses [listener][source] from those of (source, group) jobs."""
    out: list[list[np.ndarray]] = [[np.empty((0, 0))] * sources for _ in range(listeners)]
    for (s, g), responses in zip(jobs, rendered, strict=True):
        for i, response in zip(groups[g].members, responses, strict=True):
            out[i][s] = response
    return out
