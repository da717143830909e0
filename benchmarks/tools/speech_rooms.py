"""The rooms of `RoomStream`, and its shoeboxes in pyroomacoustics: of the same size, materials and places."""

from __future__ import annotations

import importlib
from typing import Any

import numpy as np

from soundspaces_sim.build.random_rooms import RandomRoom, draw_room

MOST_ORDER = 80  # of image sources: 700,000 a pair
_STREAM = 0x5EEC  # of `RoomStream`: its rooms, for others


def drawn_box(
    number: int, sources: tuple[int, int] = (1, 4), microphones: tuple[int, int] = (2, 8)
) -> RandomRoom:
    """The shoebox of that number of a stream of shoeboxes of seed 0."""
    rng = np.random.default_rng((_STREAM, 0, 0, number))
    return draw_room(rng, "room", ("shoebox",), sources, microphones)


def box_responses(
    room: RandomRoom, rate: int, order: int | None = None, rays: int = 0
) -> list[list[np.ndarray]]:
    """Of every microphone, that of every talker: image sources to an order, ray tracing beyond if there are `rays`;
    all in one call, its fastest way. The order is by default that which its `inverse_sabine` has for the room's
    reverberation time by Sabine's formula, at most `MOST_ORDER`."""
    pra = importlib.import_module("pyroomacoustics")
    pra.constants.set("num_threads", 1)
    low, high = room.scene.bounds

    def make(order: int) -> Any:
        walls, size = _materials(pra, room), high - low
        settings = {"max_order": order, "air_absorption": True, "ray_tracing": rays > 0}
        return pra.ShoeBox(size, fs=rate, materials=walls, **settings)

    if order is None:
        t60 = float(make(0).rt60_theory("sabine"))
        order = min(int(pra.inverse_sabine(t60, high - low)[1]), MOST_ORDER)
    box = make(order)
    if rays:
        box.set_ray_tracing(n_rays=rays, hist_bin_size=0.004)
    for source in room.sources:
        box.add_source(np.array(source.position) - low)
    box.add_microphone_array((room.place + room.array.offsets - low).T)
    box.compute_rir()
    return [list(of_one) for of_one in box.rir]


def _materials(pra: Any, room: RandomRoom) -> dict[str, Any]:
    """Of its six walls, by where a face lies."""
    scene = room.scene
    low, high = scene.bounds
    centres = scene.corners.mean(axis=1)
    sides = ("west", "east"), ("south", "north"), ("floor", "ceiling")
    found = {}
    for axis, pair in enumerate(sides):
        for side, at in zip(pair, (low[axis], high[axis]), strict=True):
            k = scene.face_material[int(np.abs(centres[:, axis] - at).argmin())]
            given = {"center_freqs": scene.materials.frequency_hz.tolist()}
            found[side] = pra.Material(
                {**given, "coeffs": scene.materials.absorption[k].tolist()},
                {**given, "coeffs": scene.materials.scattering[k].tolist()},
            )
    return found
