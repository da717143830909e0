"""What the disk cache may hand to kernels: whatever is forged in it, simulations go on and say the same."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import soundspaces_sim as ss
from soundspaces_sim.core.io import disk_cache as module
from soundspaces_sim.transport.preparation import make_model
from tests.marks import few
from tests.rooms import plain, table, two_rooms

ENDS = [[1.2, 1.0, 1.2]], [[3.0, 3.0, 1.3]]


def _use(folder: Path, patch: pytest.MonkeyPatch) -> Path:
    patch.setenv("SOUNDSPACES_SIM_CACHE", str(folder))
    patch.setattr(module, "_WORTH_S", -1.0)
    return folder / "scenes"


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    return _use(tmp_path, monkeypatch)


def _config(**more: Any) -> ss.SimulationConfig:
    return plain(**{"walks": 64, "duration": 0.2, "diffraction": True, "scattering": "size", **more})


def _simulate() -> np.ndarray:
    scene = two_rooms(table(0.3, 0.4, 0.01), 0)
    return ss.simulate(scene, *ENDS, _config()).energy


@pytest.fixture(scope="module")
def kept(tmp_path_factory: pytest.TempPathFactory) -> tuple[dict[str, bytes], np.ndarray]:
    """The cache's files after one simulation, by name, and what it gave."""
    with pytest.MonkeyPatch.context() as patch:
        folder = _use(tmp_path_factory.mktemp("kept"), patch)
        expected = _simulate()
        return {path.name: path.read_bytes() for path in folder.glob("*.arrays")}, expected


def _one_more(x: np.ndarray) -> np.ndarray:
    x.flat[x.size // 2] = 10**8 if x.dtype.kind == "i" else np.nan
    return x


def _below(x: np.ndarray) -> np.ndarray:
    x.flat[x.size // 2] = -(10**8)
    return x


def _turned(x: np.ndarray) -> np.ndarray:
    return x[::-1].copy()


FORGERIES: dict[str, list[tuple[str, Callable[[np.ndarray], np.ndarray]]]] = {
    "of_face": [
        ("too large", _one_more), ("below", _below), ("short", lambda x: x[:-1]),
        ("another type", lambda x: x.astype("i4")), ("real", lambda x: x.astype("f8")),
    ],
    "outward": [("short", lambda x: x[:-1]), ("too large", _one_more)],
    "thin": [("short", lambda x: x[:-1])],
    "wedges.start": [("NaN", _one_more), ("another shape", lambda x: x.reshape(-1))],
    "mutual.start": [("falls", _turned), ("too large", _one_more)],
    "mutual.wedge": [("too large", _one_more), ("below", _below)],
    "mutual.reverse": [("too large", _one_more)],
    "share": [("NaN", _one_more), ("above one", lambda x: x + 2.0)],
    "splits": [("too large", _one_more), ("none", lambda x: 0 * x)],
    "first": [("too large", _one_more), ("below", _below)],
    "of_piece": [("too large", _one_more), ("below", _below)],
    "places.start": [("too large", _one_more), ("all at the end", lambda x: np.r_[0, np.full(len(x) - 1, x[-1])])],
    "weight": [("negative", lambda x: x - 1e9)],
    "start": [("too large", _one_more), ("below", _below), ("one dimension", lambda x: x.ravel())],
    "patch": [("too large", _one_more), ("below", _below), ("short", lambda x: x[:-1])],
    "energy": [("NaN", _one_more), ("negative", lambda x: x - 1e9)],
    "length": [("NaN", _one_more)],
    "reach": [("NaN", _one_more), ("short", lambda x: x[:-1])],
}  # fmt: skip


@pytest.mark.parametrize(
    ("name", "forge"),
    few(  # of each array the first
        [(name, forge) for name, ways in FORGERIES.items() for _, forge in ways],
        *((name, ways[0][1]) for name, ways in FORGERIES.items()),
    ),
    ids=[f"{name}: {way}" for name, ways in FORGERIES.items() for way, _ in ways],
)
def test_forged_arrays_are_made_again(
    cache: Path,
    name: str,
    forge: Callable[[np.ndarray], np.ndarray],
    caplog: pytest.LogCaptureFixture,
    kept: tuple[dict[str, bytes], np.ndarray],
) -> None:
    files, expected = kept
    cache.mkdir(mode=0o700)
    forged = 0
    for file, whole in files.items():
        path, arrays = cache / file, module._unpacked(np.frombuffer(bytearray(whole), np.uint8), 32)
        if name in arrays:
            arrays[name] = forge(arrays[name])
            parts = module._packed(arrays)
            whole = b"".join([module._seal(path, *parts), *parts])
            forged += 1
        path.write_bytes(whole)
    assert forged == 1
    np.testing.assert_array_equal(_simulate(), expected)
    assert "made again" in caplog.text and "do not fit the scene" in caplog.text


def test_the_speed_of_sound_decides_what_patches_scatter() -> None:
    """What a surface scatters by its size follows the wavelength; the cache's key left that out."""
    points = np.array(ENDS[0])

    def weights(c: float) -> np.ndarray:
        scene = two_rooms(table(0.3, 0.1, 0.01), 0)
        return make_model(scene, points, _config(speed_of_sound=c)).world.patches.weight

    first = weights(343.0)
    other = weights(1500.0)
    assert not np.array_equal(first, other)
    np.testing.assert_array_equal(weights(343.0), first)
