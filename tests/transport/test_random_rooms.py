"""Rooms, materials and settings drawn at random: energies are finite, and sound cannot gain energy."""

from __future__ import annotations

import numpy as np
import pytest

import soundspaces_sim as ss
from tests.marks import CI_SLOW, few
from tests.rooms import box, plain, table, two_rooms
from tests.stats import assert_mean

_SLOW = (pytest.mark.slow,)


def _materials(rng: np.random.Generator, count: int) -> ss.MaterialTable:
    """Absorption from .001 to .999 in every band, evenly in its logit, and any scattering and transmission."""
    shape, most = (count, 4), np.log(0.999 / 0.001)
    absorption = 1.0 / (1.0 + np.exp(rng.uniform(-most, most, shape)))
    transmission = np.where(rng.uniform(size=(count, 1)) < 0.3, rng.uniform(size=shape), 0.0)
    return table(absorption, rng.uniform(size=shape), transmission * (1.0 - absorption))


def _room(rng: np.random.Generator, largest: float) -> tuple[ss.Scene, np.ndarray]:
    """A box of 2 m to the `largest`, m, furnished or not, or two rooms and a door; and its size."""
    materials = _materials(rng, 6)
    kind = rng.integers(3)
    if kind == 2:
        return two_rooms(materials, int(rng.integers(6))), np.array([8.0, 4.0, 2.5])
    size = np.exp(rng.uniform(np.log(2.0), np.log(np.minimum(largest, [20.0, 20.0, 8.0]))))
    room = box(tuple(size), materials, rng.integers(6, size=6))
    if kind == 1:
        chest = box(tuple(0.3 * size), materials, rng.integers(6, size=6))
        room = ss.Scene(
            np.concatenate([room.vertices, chest.vertices + rng.uniform(0.05, 0.65, 3) * size]),
            np.concatenate([room.faces, chest.faces + 8]),
            np.concatenate([room.face_material, chest.face_material]), materials,
        )  # fmt: skip
    return room, size


def _settings(rng: np.random.Generator) -> ss.SimulationConfig:
    bands = np.concatenate([[0.0], np.geomspace(100.0, 16000.0, int(rng.integers(1, 9)))])
    return ss.SimulationConfig(
        walks=int(rng.integers(16, 64)),
        specular=ss.SpecularConfig(ratio=int(rng.integers(1, 5))),
        bands=tuple(bands) if rng.uniform() < 0.3 else ss.SimulationConfig().bands,
        radiance_transfer=ss.RadianceTransferConfig(enabled=bool(rng.uniform() < 0.9)),
        denoise=bool(rng.uniform() < 0.7),
        diffraction=ss.DiffractionConfig(enabled=bool(rng.uniform() < 0.5)),
        reflection="angle" if rng.uniform() < 0.3 else "random",
        scattering="table" if rng.uniform() < 0.5 else "size",
        duration=float(np.exp(rng.uniform(np.log(0.03), np.log(1.5)))) if rng.uniform() < 0.5 else None,
        max_duration=2.0,
        air_absorption=bool(rng.uniform() < 0.8),
        speed_of_sound=float(rng.uniform(300.0, 400.0)),
    )


def _check_room(seed: int, largest: float) -> None:
    rng = np.random.default_rng(seed)
    scene, size = _room(rng, largest)
    config = _settings(rng)
    points = rng.uniform(0.05, 0.95, (3, 3)) * size
    echoes = ss.simulate(scene, points[:2], points, config, seed)
    energy = echoes.energy[:, :, :, 0]
    assert np.all((energy >= 0.0) & (energy < np.inf)), seed
    assert np.all(np.abs(echoes.energy) <= 1.001 * energy[:, :, :, None]), seed
    assert np.all(echoes.relative_error >= 0.0), seed  # infinite where it is not known
    assert np.all((echoes.early.energy >= 0.0) & (echoes.early.energy < np.inf)), seed
    rir = ss.ambisonic_rir(echoes[0, 2], 16000, seed=seed)
    assert np.all(np.isfinite(rir)), seed


@pytest.mark.parametrize("group", few(range(8), 0))
def test_random_rooms(group: int) -> None:
    for seed in range(5 * group, 5 * (group + 1)):
        _check_room(seed, 7.0)


@pytest.mark.slow
@pytest.mark.parametrize("group", range(20))
def test_many_random_rooms(group: int) -> None:
    for seed in range(1000 + 25 * group, 1000 + 25 * (group + 1)):
        _check_room(seed, 20.0)


# Walls of -x +x -y +y -z +z; absorption per material and band.
CONCRETE, CURTAIN = [0.02, 0.02, 0.03, 0.04], [0.05, 0.4, 0.75, 0.85]
PLASTER, CARPET, TILES = [0.1, 0.05, 0.04, 0.03], [0.05, 0.3, 0.6, 0.7], [0.3, 0.8, 0.9, 0.95]
UNEQUAL = {
    "curtains on two walls": ((4.0, 3.0, 2.5), [CONCRETE, CURTAIN], [0, 0, 1, 1, 0, 0]),
    "carpet and acoustic ceiling": ((6.0, 5.0, 3.0), [PLASTER, CARPET, TILES], [0, 0, 0, 0, 1, 2]),
    "other absorption in every band": ((6.0, 5.0, 3.0), [[0.05, 0.1, 0.3, 0.5]], 0),
    "30 dB a reflection in one band": ((4.0, 3.5, 2.5), [[0.01, 0.3, 0.999, 0.05]], 0),
}


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(n, marks=marks)
        for n, marks in zip(UNEQUAL, (CI_SLOW, _SLOW, _SLOW, CI_SLOW), strict=True)
    ],
)
def test_a_band_does_not_depend_on_how_others_decay(name: str) -> None:
    """Energies of every band are those of a room with this band's absorption in all bands."""
    size, absorption, walls = UNEQUAL[name]
    scattering, config = 0.5, plain(walks=160, specular={"ratio": 2}, duration=0.2)
    points = [[1.0, 1.0, 1.2]], [[size[0] - 0.8, size[1] - 0.9, 1.6]]

    def late(columns: np.ndarray) -> np.ndarray:
        """(seeds, bands, 2) energy from 50 to 100 and from 100 to 150 ms."""
        scene = box(size, table(columns, scattering), walls)
        echoes = [ss.simulate(scene, *points, config, seed)[0, 0] for seed in range(8)]
        return np.stack([e.histogram(0.05)[:, 1:3] for e in echoes])

    together = late(np.array(absorption))
    for band in (1, 3):
        alone = late(np.repeat(np.array(absorption)[:, [band]], 4, axis=1))[:, band]
        # Other proposal indices make other subpaths, so the difference of seeds is one of independent estimates.
        mean = alone.mean(axis=0)
        assert_mean((together[:, band] - alone) / mean, 0.0, f"band {band}", relative=0.12, scale=1.0)
