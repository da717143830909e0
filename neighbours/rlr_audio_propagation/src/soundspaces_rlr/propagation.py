"""From a scene, sources and listeners to echograms: all that this interface knows of the transport.

Listeners that stand together (capsules of an array) are a group: one simulation, at the member nearest
the group's middle, serves them all, so that what they hear fits together.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace

import msgspec
import numpy as np

from soundspaces_rlr.preparation import Kept, prepare
from soundspaces_rlr.records import Config, band_edges, check_config
from soundspaces_sim import (
    Arrivals,
    DiffractionConfig,
    Echogram,
    Echograms,
    RadianceTransferConfig,
    Scene,
    SimulationConfig,
)
from soundspaces_sim.parts import (
    DIRECT_SOUND as DIRECT,
    INV_4PI,
    LEAST_DISTANCE,
    PreparedScene,
    air_transmission,
    at_points,
    closedness,
    combine_keys as combine,
    core_count,
    direct_arrival,
    point_keys,
    set_thread_count,
    simulate_pairs,
    simulate_tile,
    thread_count,
)

GROUP_REACH = 0.3  # m from a group's first member
_RAYS_PER_WALK = 5  # of indirect_ray_count
_LEAST_WALKS = 16
SEED = 0  # of subpaths and noise
_NO_TIME = 0.001  # s, of an echogram without reverberation


@dataclass(frozen=True)
class Group:
    """Listeners simulated as one: their numbers, and the one whose place stands for all."""

    members: tuple[int, ...]
    place: int


def group_listeners(positions: np.ndarray) -> list[Group]:
    """Groups of (L, 3) positions in m: a listener belongs to the first group whose first member is in reach."""
    groups: list[list[int]] = []
    for i, position in enumerate(positions):
        for group in groups:
            if np.linalg.norm(position - positions[group[0]]) <= GROUP_REACH:
                group.append(i)
                break
        else:
            groups.append([i])
    out = []
    for group in groups:
        middle = positions[group].mean(axis=0)
        nearest = int(np.linalg.norm(positions[group] - middle, axis=1).argmin())
        out.append(Group(tuple(group), group[nearest]))
    return out


def simulation_config(config: Config) -> SimulationConfig:
    """The engine's settings for a context's. Raises `RlrError`."""
    check_config(config)
    return SimulationConfig(
        bands=band_edges(config.frequency_bands),
        walks=max(_LEAST_WALKS, round(config.indirect_ray_count / _RAYS_PER_WALK)),
        max_bounces=max(1, config.indirect_ray_depth),
        max_duration=config.max_ir_length,
        denoise=False,  # as in the original; it was measured with radiance transfer on
        # what pays over many points would be traced for a few, and again after every move
        radiance_transfer=RadianceTransferConfig(enabled=False),
        diffraction=DiffractionConfig(
            enabled=False
        ),  # as in the original, where the flag changes nothing
        scattering="table",  # as in the original
    )


@contextmanager
def threads(count: int) -> Iterator[int]:
    """Kernels run in `count` threads, as far as there are that many."""
    before = thread_count()
    wanted = max(1, min(count, core_count()))
    set_thread_count(wanted)
    try:
        yield wanted
    finally:
        set_thread_count(before)


def noise_seeds(sources: np.ndarray, places: np.ndarray, coherent: bool) -> np.ndarray:
    """(S, P) seeds of the noise: of the points, so that a pair sounds the same whatever else is simulated;
    if `coherent` of their numbers, so that noise does not change as they move."""
    if coherent:
        keys = [
            [np.uint64(combine(SEED, i)) for i in range(len(points))] for points in (sources, places)
        ]
    else:
        keys = [list(point_keys(points, SEED)) for points in (sources, places)]
    return np.array([[int(combine(a, b)) for b in keys[1]] for a in keys[0]], np.uint64)


class Propagation:
    """Simulations in one scene (None: the free field); what depends on the scene alone is made once.

    `owner` (F,): the object of each face. `kept`: parts of scenes before this one, whatever of it is still right.
    """

    def __init__(self, scene: Scene | None, owner: np.ndarray, kept: Kept) -> None:
        self.scene = scene
        self._owner, self._kept = owner, kept
        self._models: dict[bool, PreparedScene] = {}

    def echograms(self, sources: np.ndarray, places: np.ndarray, config: Config) -> list[list[Echogram]]:
        """Echograms [source][place] between (S, 3) and (P, 3) points, in m, config applied."""
        settings = simulation_config(config)
        if self.scene is None:
            rows = [[_free_field(a, b, settings) for b in places] for a in sources]
        else:
            table = self._simulate(self.scene, sources, places, settings, bool(config.indirect))
            rows = [[table[s, p] for p in range(len(places))] for s in range(len(sources))]
        if not config.direct:
            rows = [[replace(echogram, direct=None) for echogram in row] for row in rows]
        return rows

    def _simulate(
        self,
        scene: Scene,
        sources: np.ndarray,
        places: np.ndarray,
        settings: SimulationConfig,
        indirect: bool,
    ) -> Echograms:
        if not indirect:
            settings = msgspec.structs.replace(settings, duration=_NO_TIME)
        known = self._models.get(indirect)
        points = np.unique(np.concatenate([sources, places]), axis=0)
        if known is None or known.config != settings:
            if not self._models:
                self._kept.start_scene()
            known = prepare(scene, self._owner, settings, self._kept)
            self._models[indirect] = known
        model = at_points(known, points, SEED)
        if indirect:
            return simulate_pairs(model, sources, places, both_ways=False)[0]
        return simulate_tile(model, sources, places, both_ways=False, techniques=[DIRECT])[0]

    def efficiency(self, points: np.ndarray) -> float:
        """Mean share of rays from (N, 3) points that do not escape, 0 to 1; nothing stops them in the
        free field."""
        if self.scene is None:
            return 0.0
        return float(closedness(self.scene, points)[0].mean())


def _free_field(source: np.ndarray, place: np.ndarray, settings: SimulationConfig) -> Echogram:
    """The direct sound, where there is nothing else."""
    bands = len(settings.bands) - 1
    offset = source - place
    length = float(np.linalg.norm(offset))
    spread = INV_4PI / max(length, LEAST_DISTANCE) ** 2
    energy = spread * air_transmission(settings, np.array(length))
    none = Arrivals(np.empty(0), np.empty((0, bands)), np.empty((0, 3)), np.empty((0, 2), int))
    return Echogram(
        settings.bands,
        np.array([0.0, _NO_TIME]),
        np.zeros((1, 9, bands), np.float32),
        direct_arrival(offset, length, energy, settings.c),
        none,
        np.zeros((2, bands), np.float32),
        True,
        air=settings.air,
    )


def seen_from(echogram: Echogram, offset: np.ndarray, least: float) -> Echogram:
    """The discrete arrivals of an echogram as they are `offset` (3,) m beside its place.

    A mirrored path comes from an image source that stays where it is: at `delay` times the speed of
    sound along the direction of arrival. Length, direction and spreading follow; walls do not change.
    """
    direct = echogram.direct
    if direct is not None:
        delay, energy, direction = _moved(
            np.array([direct.delay]), direct.energy[None], direct.direction[None], offset, least
        )
        direct = replace(direct, delay=float(delay[0]), energy=energy[0], direction=direction[0])
    early = echogram.early
    delay, energy, direction = _moved(early.delay, early.energy, early.direction, offset, least)
    return replace(
        echogram, direct=direct, early=replace(early, delay=delay, energy=energy, direction=direction)
    )


def _moved(
    delay: np.ndarray, energy: np.ndarray, direction: np.ndarray, offset: np.ndarray, least: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    c = SimulationConfig().c
    before = delay * c
    image = direction * before[:, None] - offset
    length = np.linalg.norm(image, axis=1)
    spread = (np.maximum(before, least) / np.maximum(length, least)) ** 2
    unit = image / np.maximum(length, 1e-12)[:, None]
    return length / c, energy * spread[:, None], unit
