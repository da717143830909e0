"""An endless stream of random rooms with responses, targets, labels and mixtures: for training models of speech.

Every room is a function of (seed, epoch, number) alone: workers take numbers in turn, so that none is made
twice, and a run can be repeated with any number of them.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal, get_args

import msgspec
import numpy as np
from scipy.signal import oaconvolve

from soundspaces_rooms.low_equalisation import check_deviation, equalised
from soundspaces_rooms.many_rooms import room_named
from soundspaces_sim import (
    ConfigError,
    Echograms,
    MicrophoneArray,
    Scene,
    SimulationConfig,
    SimulationError,
    Source,
    Talker,
    array_rir,
    load_scene,
    shoebox,
)
from soundspaces_sim.parts import (
    DIRECT_S,
    MEASURES,
    check_rate,
    closedness,
    directed_table,
    echograms_measures,
    model_between,
    of_simulation,
    pair_seed,
    simulate_pairs,
)

# Random rooms for speech: a scene, one to four talkers and a small array of microphones, of one generator.
#
# Rooms are shoeboxes, prisms on convex polygons, and the furnished scenes ``room-<n>``. Surfaces are drawn from
# sets of those materials of `materials/materials.toml` that such a surface has.

RoomKind = Literal["shoebox", "polygon", "furnished"]
KINDS: tuple[RoomKind, ...] = get_args(RoomKind)

#: What surfaces may be made of, each as likely as the next.
MATERIALS: Mapping[str, Sequence[str]] = {
    "floor": (
        "carpet",
        "carpet-thin",
        "wood-floor",
        "parquet",
        "linoleum",
        "ceramic-tile",
        "concrete-floor",
    ),
    "wall": (
        "plaster",
        "gypsum-board",
        "brick-painted",
        "concrete",
        "wood-panel",
        "acoustic-plaster",
        "curtain-cotton",
    ),
    "ceiling": (
        "plaster",
        "plasterboard-ceiling",
        "mineral-wool-ceiling",
        "perforated-gypsum-ceiling",
        "concrete",
    ),
}
_LENGTH, _HEIGHT = (2.5, 10.0), (2.3, 4.0)  # m
_MOUTH, _MICROPHONE = (
    (1.1, 1.8),
    (0.6, 1.8),
)  # m above the floor: seated and standing people; tables and shelves
_MARGIN = 0.4  # m from any surface
_LEAST = 0.5  # m between a mouth and the array
_RADIUS = (0.02, 0.10)  # m, of arrays
_FURNISHED = 100_000  # numbers of scenes to choose from
_TRIES = 2000


@dataclass(frozen=True)
class RandomRoom:
    """`sources` are talkers with headings; the centre of the `array` is at `place` (3,) m."""

    kind: RoomKind
    scene: Scene
    sources: tuple[Source, ...]
    array: MicrophoneArray
    place: np.ndarray


def draw_room(
    rng: np.random.Generator,
    name: str,
    kinds: Sequence[RoomKind] = KINDS,
    sources: tuple[int, int] = (1, 4),
    microphones: tuple[int, int] = (2, 8),
) -> RandomRoom:
    """A room, with numbers of talkers and microphones between the two given, both included. Raises
    `ConfigError`, and `SimulationError` if nothing that was drawn has room for all."""
    check_numbers(kinds, sources, microphones)
    kind = kinds[int(rng.integers(len(kinds)))]
    scene = _SCENES[kind](rng, name)
    array = _array(rng, int(rng.integers(microphones[0], microphones[1] + 1)))
    count = int(rng.integers(sources[0], sources[1] + 1))
    place = _places(rng, scene, 1, _MICROPHONE, np.empty((0, 3)))[0]
    mouths = _places(rng, scene, count, _MOUTH, place[None])
    ends = tuple(
        Source(tuple(mouth), Talker(), heading_deg=float(rng.uniform(0.0, 360.0))) for mouth in mouths
    )
    return RandomRoom(kind, scene, ends, array, place)


def check_numbers(kinds: Sequence[str], sources: tuple[int, int], microphones: tuple[int, int]) -> None:
    """Raises `ConfigError` for what `draw_room` does not take."""
    if not kinds or not set(kinds) <= set(KINDS):
        raise ConfigError(f"kinds: expected some of {', '.join(KINDS)}, got {tuple(kinds)!r}")
    for what, (low, high), least, most in (
        ("sources", sources, 1, 4),
        ("microphones", microphones, 1, 8),
    ):
        if not least <= low <= high <= most:
            raise ConfigError(f"{what}: expected least and most, {least} to {most}, got {(low, high)}")


def _surface(rng: np.random.Generator, what: str) -> str:
    return str(rng.choice(MATERIALS[what]))


def _shoebox(rng: np.random.Generator, name: str) -> Scene:
    size = (*rng.uniform(*_LENGTH, 2), rng.uniform(*_HEIGHT))
    walls = {wall: _surface(rng, "wall") for wall in ("west", "east", "south", "north")}
    walls |= {what: _surface(rng, what) for what in ("floor", "ceiling")}
    return shoebox(size, walls, name=name)


def _polygon(rng: np.random.Generator, name: str) -> Scene:
    """A prism on a convex polygon of four to eight corners on an ellipse."""
    corners = int(rng.integers(4, 9))
    angle = 2.0 * np.pi * (np.arange(corners) + rng.uniform(-0.3, 0.3, corners)) / corners
    across = 0.5 * rng.uniform(3.5, _LENGTH[1], 2)
    base = across * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    height = float(rng.uniform(*_HEIGHT))
    floor, ceiling = (np.column_stack([base, np.full(corners, z)]) for z in (0.0, height))
    rows = np.arange(corners)
    beyond = (rows + 1) % corners
    walls = [
        [a, b, c]
        for i, j in zip(rows, beyond, strict=True)
        for a, b, c in ((i, i + corners, j), (j, i + corners, j + corners))
    ]
    ground = [[0, k, k + 1] for k in range(1, corners - 1)]
    faces = [*walls, *ground, *([corners, corners + k + 1, corners + k] for k in range(1, corners - 1))]
    stuff: list[str] = [m for _ in rows for m in (_surface(rng, "wall"),) * 2]
    stuff += [_surface(rng, "floor")] * (corners - 2) + [_surface(rng, "ceiling")] * (corners - 2)
    return Scene.from_arrays(np.vstack([floor, ceiling]), np.array(faces), stuff, name=name)


def _furnished(rng: np.random.Generator, _name: str) -> Scene:
    return load_scene(f"room-{int(rng.integers(_FURNISHED))}")


_SCENES = {"shoebox": _shoebox, "polygon": _polygon, "furnished": _furnished}


def _array(rng: np.random.Generator, count: int) -> MicrophoneArray:
    """Capsules on a circle, on a line, or anywhere on a sphere, turned at random about the vertical."""
    radius, shape = rng.uniform(*_RADIUS), int(rng.integers(3))
    if shape == 0:
        angle = 2.0 * np.pi * np.arange(count) / count
        offsets = np.stack([np.cos(angle), np.sin(angle), np.zeros(count)], axis=1)
    elif shape == 1:
        offsets = np.zeros((count, 3))
        offsets[:, 1] = np.linspace(-1.0, 1.0, count) if count > 1 else 0.0
    else:
        offsets = rng.normal(size=(count, 3))
        offsets /= np.linalg.norm(offsets, axis=1, keepdims=True)
    return MicrophoneArray(radius * offsets, heading_deg=float(rng.uniform(0.0, 360.0)))


def _are_free(scene: Scene, places: np.ndarray) -> np.ndarray:
    """(N,) whether places (N, 3) are in the room, `_MARGIN` from surfaces."""
    closed, clearance = closedness(scene, places, 64, 8)
    return np.asarray((closed > 0.99) & (clearance > _MARGIN))


def _places(
    rng: np.random.Generator, scene: Scene, count: int, heights: tuple[float, float], taken: np.ndarray
) -> np.ndarray:
    """(count, 3) places in the room, `_MARGIN` from surfaces and `_LEAST` from what is taken."""
    low, high = scene.bounds
    found = np.empty((0, 3))
    for _ in range(_TRIES // 50):
        some = rng.uniform((*low[:2], low[2] + heights[0]), (*high[:2], low[2] + heights[1]), (50, 3))
        for place in some[_are_free(scene, some)]:
            near = np.linalg.norm(np.vstack([taken, found]) - place, axis=1)
            if near.min(initial=np.inf) >= _LEAST and len(found) < count:
                found = np.vstack([found, place])
        if len(found) == count:
            return found
    raise SimulationError(f"{scene.name}: no room for {count} places {_MARGIN} m from all surfaces")


Item = dict[str, Any]
EARLY_S = 0.05  # after the direct sound
LABELS = ("t30", "c50", "drr")
_STREAM = 0x5EEC
_ORDERS, _TURNS = 8, 6  # rooms for one that is to order, and simulations of each
_OFF, _OFF_DB = 0.1, 1.0  # of the T30 that is wanted, and of the ratio of direct to reverberant sound
_PLACES = 200  # that are tried for a talker
_POWERS = (0.1, 10.0)  # beyond which surfaces are none that rooms have
_MID_HZ = (354.0, 1414.0)  # the octaves of 500 and 1,000 Hz
_LOW = 1  # the stream of the equalisation's random numbers, beside that of a room


class RoomStream:
    """Items of random rooms (`random_rooms.draw_room`), for ever or `count` of them; PyTorch takes it as
    `torch_rooms.TorchRoomStream`.

    An item is a dict. ``room``: its number; ``kind``; ``sources`` (S, 3), ``array`` (3,) and ``microphones`` (K, 3)
    m; ``heading_deg`` (S,) of the talkers; ``rir`` (S, K, n) float32 responses at `rate` Hz, and, of the same
    samples, ``direct`` up to 2.5 ms and ``early`` up to 50 ms after the direct sound's arrival at each
    microphone (``arrival_s``, (S, K)), zeros after. ``t30`` s, ``c50``, ``drr`` dB (S, bands) at the array's
    centre with the talkers' directivity, and ``t30_error`` and so on: their standard errors, of an
    omnidirectional source there; NaN where not known.

    With dry speech, `speech` (arrays at `rate` Hz, or a function of a generator that gives one), also ``mixture``
    (K, m), ``reverberant``, ``early_speech`` and ``direct_speech`` (S, K, m), with m = `seconds` * `rate`:
    crops drawn at random, convolved, added up, with noise of each microphone's own (white, Gaussian) at
    ``snr_db`` dB below the speech at the first microphone, drawn evenly from `snr_db`; None is no noise.

    `low_equalisation_db`: standard deviation of random gains of the reverberation in third octaves below 200 Hz,
    one filter for each talker (`rendering.low_equalisation`); 0 is none. Labels are those before it.

    `t30`: least and most, s, of the mean of the talkers' T30 in the bands about 500 and 1,000 Hz, drawn evenly
    for each room (``t30_wanted``). Reflection coefficients of all surfaces are raised to one power
    (``reflection_power``), under Eyring's formula the inverse of the factor to T30, until the simulated T30 is
    within 10 % of what is wanted; rooms that do not get there are drawn anew. The label ``t30`` says what came out.
    Surfaces then absorb at random incidence, as in that formula, unless `config` names another law.

    `drr`: least and most, dB, of every talker's ratio of direct to reverberant sound (up to 2.5 ms and later, mean
    of the same bands), drawn evenly for each (``drr_wanted``, (S,)). Talkers move (twice as far is 6 dB less where
    reverberation is even) until the simulated ratio is within 1 dB of what is wanted; the label ``drr`` says what
    came out.

    `set_epoch`: other rooms, surfaces, places and headings. `shard` (k, n): only every n-th room, from the k-th
    (from 0), as `share` gives them. `config`: by default subpaths are added until every pair
    has an error of 5 %. Raises `ConfigError`; errors of a room name its number.
    """

    def __init__(
        self,
        seed: int = 0,
        count: int | None = None,
        rate: int = 16000,
        config: SimulationConfig | None = None,
        kinds: Sequence[RoomKind] = KINDS,
        sources: tuple[int, int] = (1, 4),
        microphones: tuple[int, int] = (2, 8),
        speech: Sequence[np.ndarray] | Callable[[np.random.Generator], np.ndarray] | None = None,
        seconds: float = 4.0,
        snr_db: tuple[float, float] | None = (0.0, 30.0),
        shard: tuple[int, int] = (0, 1),
        low_equalisation_db: float = 0.0,
        t30: tuple[float, float] | None = None,
        drr: tuple[float, float] | None = None,
    ) -> None:
        check_numbers(kinds, sources, microphones)
        if count is not None and count < 0:
            raise ConfigError(f"count: expected 0 or more, got {count}")
        if not 0 <= shard[0] < shard[1]:
            raise ConfigError(f"shard: expected (k, n) with 0 <= k < n, got {shard}")
        if not 0.1 <= seconds <= 600.0:
            raise ConfigError(f"seconds: expected 0.1 to 600, got {seconds}")
        if snr_db is not None and not -60.0 <= snr_db[0] <= snr_db[1] <= 120.0:
            raise ConfigError(f"snr_db: expected least and most, -60 to 120 dB, got {snr_db}")
        if seed < 0:
            raise ConfigError(f"seed: expected 0 or more, got {seed}")
        self.rate, self.seed, self.count, self.shard = check_rate(rate), seed, count, shard
        config = config or SimulationConfig()
        if t30 is not None and config.reflection is None:
            config = msgspec.structs.replace(config, reflection="random")  # as in Eyring's formula
        self.config = of_simulation(config)
        self.kinds, self.sources, self.microphones = tuple(kinds), sources, microphones
        self.seconds, self.snr_db = seconds, snr_db
        self.speech = speech if speech is None or callable(speech) else [_checked(x) for x in speech]
        if self.speech == []:
            raise ConfigError("speech: expected at least one clip")
        self.low_equalisation_db = check_deviation(low_equalisation_db)
        if t30 is not None and not 0.05 <= t30[0] <= t30[1] <= 10.0:
            raise ConfigError(f"t30: expected least and most, 0.05 to 10 s, got {t30}")
        if drr is not None and not -40.0 <= drr[0] <= drr[1] <= 40.0:
            raise ConfigError(f"drr: expected least and most, -40 to 40 dB, got {drr}")
        self.t30, self.drr = t30, drr
        self.epoch = 0

    def set_epoch(self, epoch: int) -> None:
        """Other rooms from the next iteration on."""
        if epoch < 0:
            raise ConfigError(f"epoch: expected 0 or more, got {epoch}")
        self.epoch = epoch

    def __iter__(self) -> Iterator[Item]:
        number = self.shard[0]
        while self.count is None or number < self.count:
            yield self.item(number)
            number += self.shard[1]

    def share(self, k: int, n: int) -> RoomStream:
        """Every n-th room of this stream, from its k-th (from 0). Raises `ConfigError`."""
        if not 0 <= k < n:
            raise ConfigError(f"share: expected 0 <= k < n, got {k}, {n}")
        out = copy.copy(self)
        out.shard = self.shard[0] + self.shard[1] * k, self.shard[1] * n
        return out

    def item(self, number: int) -> Item:
        """Room `number` of the epoch."""
        rng = np.random.default_rng((_STREAM, self.seed, self.epoch, number))
        with room_named(number):
            room, seed, echoes, of_order = self._room(rng, f"room {number}")
            out = _responses(room, echoes, self.rate, seed)
            if self.low_equalisation_db:
                own = np.random.default_rng((_STREAM, self.seed, self.epoch, number, _LOW))
                late = out["rir"] - out["direct"]
                out["rir"] = out["direct"] + equalised(own, late, self.low_equalisation_db, self.rate)
            out |= {
                "early": _until(out, EARLY_S, self.rate),
                **_labels(echoes),
                **of_order,
                "room": number,
            }
            if self.speech is not None:
                out |= self._signals(rng, out)
        return out

    def _room(self, rng: np.random.Generator, name: str) -> tuple[RandomRoom, int, Echograms, Item]:
        """A room, its seed, its echograms, and, of one to order, what was wanted. Raises `SimulationError` where
        no room of many gets there."""
        t30 = None if self.t30 is None else float(rng.uniform(*self.t30))
        for _ in range(_ORDERS):
            room = draw_room(rng, name, self.kinds, self.sources, self.microphones)
            seed = int(rng.integers(2**31))
            drr = None if self.drr is None else rng.uniform(*self.drr, len(room.sources))
            if (found := self._to_order(rng, room, seed, t30, drr)) is not None:
                return found
        asked = (
            [] if self.t30 is None else [f"a T30 of {t30:.2f} s by surfaces that reflect more or less"]
        )
        if self.drr is not None:
            asked.append(f"{self.drr[0]:g} to {self.drr[1]:g} dB of direct to reverberant sound")
        raise SimulationError(
            f"{name}: none of {_ORDERS} rooms has {', and '.join(asked)}; choose them nearer to what rooms of "
            "these kinds have, or a longer duration"
        )

    def _to_order(
        self,
        rng: np.random.Generator,
        room: RandomRoom,
        seed: int,
        t30: float | None,
        drr: np.ndarray | None,
    ) -> tuple[RandomRoom, int, Echograms, Item] | None:
        """As `_room`, of `room` with other surfaces and places of talkers; None if it does not get there."""
        power = 1.0
        for _ in range(_TURNS):
            tried = replace(room, scene=_with_reflections(room.scene, power))
            echoes, done, of_order = _echograms(tried, self.config, seed), True, Item()
            if t30 is not None:
                found = float(_middle(echoes, "t30").mean())
                done = abs(found / t30 - 1.0) <= _OFF
                of_order |= {"t30_wanted": t30, "reflection_power": power}
                # Not known where the echogram ends before sound has fallen by 35 dB: then less has to be reflected.
                if not done:
                    power *= found / t30 if np.isfinite(found) else 2.0
            if drr is not None:
                apart = _middle(echoes, "drr") - drr
                of_order |= {"drr_wanted": drr}
                if not (np.abs(apart) <= _OFF_DB).all():
                    done = False
                    if (moved := _moved(rng, room, apart)) is None:
                        return None
                    room = moved
            if done:
                return tried, seed, echoes, of_order
            if not _POWERS[0] <= power <= _POWERS[1]:
                return None
        return None

    def _signals(self, rng: np.random.Generator, item: Item) -> Item:
        samples = round(self.seconds * self.rate)
        dry = np.stack([_crop(rng, self._clip(rng), samples) for _ in item["rir"]])
        heard = {
            name: _convolved(dry, item[of])
            for name, of in (
                ("reverberant", "rir"),
                ("early_speech", "early"),
                ("direct_speech", "direct"),
            )
        }
        mixture = heard["reverberant"].sum(axis=0)
        if self.snr_db is None:
            return {**heard, "mixture": mixture}
        snr = float(rng.uniform(*self.snr_db))
        noise = rng.standard_normal(mixture.shape).astype(np.float32)
        # scaled by what was drawn, so that the ratio is the stated one and not one in the mean
        power = float(np.mean(noise[0].astype(float) ** 2))
        level = float(np.mean(mixture[0].astype(float) ** 2)) / power * 10.0 ** (-snr / 10.0)
        return {**heard, "mixture": mixture + np.float32(np.sqrt(level)) * noise, "snr_db": snr}

    def _clip(self, rng: np.random.Generator) -> np.ndarray:
        if callable(self.speech):
            return _checked(self.speech(rng))
        assert self.speech is not None
        return self.speech[int(rng.integers(len(self.speech)))]


def _checked(clip: Any) -> np.ndarray:
    """A clip (n,) float32. Raises `ConfigError`."""
    clip = np.asarray(clip, np.float32)
    if clip.ndim != 1 or not len(clip) or not np.isfinite(clip).all():
        raise ConfigError(f"speech: expected finite clips of shape (n,), got one of {clip.shape}")
    return clip


def _with_reflections(scene: Scene, power: float) -> Scene:
    """A scene whose surfaces reflect the share of energy that they did to a power. What is let through is as
    before, as far as what is not reflected leaves room for it."""
    if power == 1.0:
        return scene
    table = scene.materials
    reflected = np.maximum(1.0 - table.absorption - table.transmission, 0.0) ** power
    through = np.minimum(table.transmission, 1.0 - reflected)
    absorption = np.maximum(1.0 - reflected - through, 0.0)
    return replace(scene, materials=replace(table, absorption=absorption, transmission=through))


def _middle(echoes: Echograms, measure: str) -> np.ndarray:
    """(S,) means of a measure of the talkers over the bands about 500 and 1,000 Hz; NaN where one is not known."""
    edges = np.asarray(echoes.bands)
    centres = np.sqrt(np.maximum(edges[:-1], 1.0) * edges[1:])
    rows = (centres >= _MID_HZ[0]) & (centres <= _MID_HZ[1])
    found = echograms_measures(echoes)[measure][:, 0]
    return np.asarray(found[:, rows if rows.any() else slice(None)].mean(axis=1))


def _moved(rng: np.random.Generator, room: RandomRoom, apart: np.ndarray) -> RandomRoom | None:
    """A room whose talkers are so far from the array that ratios of direct to reverberant sound, which are off by
    `apart` (S,) dB, are right where reverberation is even; None if there is no such place in the room.

    A talker stays in the direction in which it is if there is room, and turns about the array if not, or if it is
    out of sight of it (NaN).
    """
    low = room.scene.bounds[0]
    mouths = np.array([source.position for source in room.sources])
    for s, off in enumerate(apart):
        if abs(off) <= _OFF_DB:
            continue
        arrow = mouths[s] - room.place
        distance = float(np.linalg.norm(arrow)) * 10.0 ** (np.nan_to_num(off) / 20.0)
        height = np.append(mouths[s, 2], low[2] + rng.uniform(*_MOUTH, _PLACES - 1)) - room.place[2]
        across = np.sqrt(np.maximum(distance**2 - height**2, 0.0))
        turn = np.arctan2(arrow[1], arrow[0]) + np.append(0.0, rng.uniform(-np.pi, np.pi, _PLACES - 1))
        some = room.place + np.stack([across * np.cos(turn), across * np.sin(turn), height], axis=1)
        others = np.vstack([room.place[None], np.delete(mouths, s, axis=0)])
        near = np.linalg.norm(some[:, None] - others[None], axis=2).min(axis=1)
        free = _are_free(room.scene, some) & (near >= _LEAST) & (np.abs(height) <= distance)
        free[0] &= np.isfinite(off)
        if not free.any():
            return None
        mouths[s] = some[free.argmax()]
    sources = (
        replace(source, position=tuple(mouth))
        for source, mouth in zip(room.sources, mouths, strict=True)
    )
    return replace(room, sources=tuple(sources))


def _echograms(room: RandomRoom, config: SimulationConfig, seed: int) -> Echograms:
    """From the talkers to the array's centre. Standard errors of measures are those of omnidirectional sources
    at the same places: batches of subpaths are not kept by direction of departure."""
    mouths = np.array([source.position for source in room.sources])
    model = model_between(room.scene, mouths, room.place[None], config, seed)
    there, back = simulate_pairs(model, mouths, room.place[None])
    rows = np.arange(len(mouths))
    heard = directed_table(there, back, rows, np.zeros(1, int), room.sources, None)
    return replace(heard, measure_error=there.measure_error)


def _responses(room: RandomRoom, echoes: Echograms, rate: int, seed: int) -> Item:
    places = room.place + room.array.offsets
    found = [
        array_rir(echoes[s, 0], room.array, rate, pair_seed(seed, s, 0), echoes.speed_of_sound)
        for s in range(len(room.sources))
    ]
    rir = np.zeros((len(found), len(places), max(r.shape[1] for r in found)), np.float32)
    for row, response in zip(rir, found, strict=True):
        row[:, : response.shape[1]] = response
    way = np.linalg.norm(echoes.sources[:, None] - places[None], axis=2) / echoes.speed_of_sound
    headings = np.array([source.heading_deg for source in room.sources])
    ends = {"sources": np.array(echoes.sources), "array": room.place, "microphones": places}
    out = {"kind": room.kind, **ends, "heading_deg": headings, "arrival_s": way, "rir": rir}
    return out | {"direct": _until(out, DIRECT_S, rate)}


def _until(item: Item, after: float, rate: int) -> np.ndarray:
    """Responses up to so many seconds after the direct sound's arrival, zeros from then on."""
    times = np.arange(item["rir"].shape[2]) / rate
    return np.where(times <= item["arrival_s"][:, :, None] + after, item["rir"], np.float32(0.0))


def _labels(echoes: Echograms) -> Item:
    """Measures (S, bands) and their standard errors."""
    measures = echograms_measures(echoes)
    out: Item = {name: measures[name][:, 0] for name in LABELS}
    for name in LABELS:
        error = echoes.measure_error
        known = np.full_like(out[name], np.nan) if error is None else error[:, 0, MEASURES.index(name)]
        out[f"{name}_error"] = np.array(known, float)
    return out


def _crop(rng: np.random.Generator, clip: np.ndarray, samples: int) -> np.ndarray:
    """A random stretch, or the clip at a random place among zeros."""
    if len(clip) >= samples:
        first = int(rng.integers(len(clip) - samples + 1))
        return clip[first : first + samples]
    out = np.zeros(samples, np.float32)
    first = int(rng.integers(samples - len(clip) + 1))
    out[first : first + len(clip)] = clip
    return out


def _convolved(dry: np.ndarray, responses: np.ndarray) -> np.ndarray:
    """(S, K, m) of dry (S, m) and responses (S, K, n), cut to m."""
    full = oaconvolve(dry[:, None, :], responses, axes=2)
    return np.asarray(full[:, :, : dry.shape[1]], np.float32)
