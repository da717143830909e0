"""What is kept on disk of a scene's preparation: the same to the bit, or made again."""

from __future__ import annotations

import os
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

import soundspaces_sim as ss
from soundspaces_sim.files import kept as module
from soundspaces_sim.files.kept import kept
from tests.rooms import plain, table, two_rooms


class _Inner(NamedTuple):
    rows: np.ndarray
    flags: np.ndarray


class _Outer(NamedTuple):
    name: np.ndarray
    inner: _Inner


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty cache that takes everything, however quickly it was made."""
    monkeypatch.setenv("SOUNDSPACES_SIM_CACHE", str(tmp_path))
    monkeypatch.setattr(module, "_WORTH_S", -1.0)
    return tmp_path / "scenes"


class _Maker:
    def __init__(self) -> None:
        self.calls = 0

    def __call__(self) -> _Outer:
        self.calls += 1
        rows = np.arange(6, dtype=np.float32).reshape(2, 3) / 7.0
        return _Outer(np.array([3, 1]), _Inner(rows, np.array([[True, False]])))


def _same(a: _Outer, b: _Outer) -> bool:
    pairs = [(a.name, b.name), (a.inner.rows, b.inner.rows), (a.inner.flags, b.inner.flags)]
    return all(x.dtype == y.dtype and np.array_equal(x, y) for x, y in pairs)


def test_made_once_for_a_key(cache: Path) -> None:
    make = _Maker()
    first = kept(_Outer, ("scene", 1), make)
    again = kept(_Outer, ("scene", 1), make)
    assert make.calls == 1 and _same(first, again) and isinstance(again.inner, _Inner)
    kept(_Outer, ("scene", 2), make)
    assert make.calls == 2 and len(list(cache.glob("*.npz"))) == 2


@pytest.mark.parametrize("damage", ["cut", "flipped", "empty", "another layout"])
def test_what_is_damaged_is_made_again(cache: Path, damage: str) -> None:
    make = _Maker()
    first = kept(_Outer, ("scene",), make)
    (path,) = cache.glob("*.npz")
    content = bytearray(path.read_bytes())
    if damage == "flipped":
        content[len(content) // 2] ^= 1
    if damage == "another layout":
        kept(_Inner, ("scene",), lambda: _Inner(np.zeros(1), np.zeros(1)))
        (other,) = {*cache.glob("*.npz")} - {path}
        content = bytearray(other.read_bytes())
    path.write_bytes({"cut": bytes(content[:-9]), "empty": b""}.get(damage, bytes(content)))
    assert _same(kept(_Outer, ("scene",), make), first) and make.calls == 2
    assert _same(kept(_Outer, ("scene",), make), first) and make.calls == 2, "it was mended on disk"


def test_other_code_or_another_cpu_is_another_key(monkeypatch: pytest.MonkeyPatch) -> None:
    make = _Maker()
    kept(_Outer, ("scene",), make)
    monkeypatch.setattr(module, "_engine", lambda: ("other code",))
    kept(_Outer, ("scene",), make)
    assert make.calls == 2


def test_without_a_place_nothing_is_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "file").write_text("not a folder")
    monkeypatch.setenv("SOUNDSPACES_SIM_CACHE", str(tmp_path / "file"))
    make = _Maker()
    assert _same(kept(_Outer, ("scene",), make), kept(_Outer, ("scene",), make)) and make.calls == 2


def test_those_unused_for_longest_go(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    make = _Maker()
    kept(_Outer, (0,), make)
    (path,) = cache.glob("*.npz")
    monkeypatch.setattr(module, "_MOST", 3 * path.stat().st_size)
    os.utime(path, (5, 5))
    for k in (1, 2):
        before = {*cache.glob("*.npz")}
        kept(_Outer, (k,), make)
        (new,) = {*cache.glob("*.npz")} - before
        os.utime(new, (k, k))  # 1 is the oldest, then 2, then 0
    kept(_Outer, (1,), make)  # used again: now 2 is
    kept(_Outer, (3,), make)
    assert make.calls == 4 and len(list(cache.glob("*.npz"))) == 3
    for k in (0, 1, 3):
        kept(_Outer, (k,), make)
    assert make.calls == 4
    kept(_Outer, (2,), make)
    assert make.calls == 5


def test_a_kept_scene_sounds_the_same(cache: Path) -> None:
    """Echograms with what was made and with what was read are the same to the bit, bars included; another seed or
    scattering is another scene."""
    settings = {"walks": 64, "duration": 0.2, "diffraction": True}

    def run(seed: int, **more: object) -> ss.Echograms:
        scene = two_rooms(table(0.3, 0.4, 0.01), 0)
        config = plain(**{**settings, **more})
        return ss.simulate(scene, [[1.2, 1.0, 1.2]], [[3.0, 3.0, 1.3], [6.5, 2.8, 1.4]], config, seed)

    first = run(0, scattering="size")
    assert len(list(cache.glob("*.npz"))) == 3  # of the scene, its patches, the walks that points share
    again = run(0, scattering="size")
    assert len(list(cache.glob("*.npz"))) == 3
    np.testing.assert_array_equal(first.energy, again.energy)
    np.testing.assert_array_equal(first.relative_error, again.relative_error)
    run(1, scattering="size")
    assert len(list(cache.glob("*.npz"))) == 4
    run(0, scattering="table")
    assert len(list(cache.glob("*.npz"))) == 7
