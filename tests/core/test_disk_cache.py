"""What is kept on disk of a scene's preparation: the same to the bit, or made again."""

from __future__ import annotations

import hashlib
import os
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

import soundspaces_sim as ss
from soundspaces_sim.core.io import disk_cache as module
from soundspaces_sim.core.io.disk_cache import fingerprint
from soundspaces_sim.core.io.files import cache_root
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


def kept(like: Any, key: tuple[object, ...], make: Any, fits: Any = lambda _: True) -> Any:
    return module.cached_on_disk(like, key, make, fits)


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
    assert make.calls == 2 and len(list(cache.glob("*.arrays"))) == 2


@pytest.mark.parametrize("damage", ["cut", "flipped", "empty", "another layout"])
def test_what_is_damaged_is_made_again(cache: Path, damage: str) -> None:
    make = _Maker()
    first = kept(_Outer, ("scene",), make)
    (path,) = cache.glob("*.arrays")
    content = bytearray(path.read_bytes())
    if damage == "flipped":
        content[len(content) // 2] ^= 1
    if damage == "another layout":
        kept(_Inner, ("scene",), lambda: _Inner(np.zeros(1), np.zeros(1)))
        (other,) = {*cache.glob("*.arrays")} - {path}
        content = bytearray(other.read_bytes())
    path.write_bytes({"cut": bytes(content[:-9]), "empty": b""}.get(damage, bytes(content)))
    assert _same(kept(_Outer, ("scene",), make), first) and make.calls == 2
    assert _same(kept(_Outer, ("scene",), make), first) and make.calls == 2, "it was mended on disk"


def test_what_does_not_fit_is_made_again(cache: Path) -> None:
    make = _Maker()
    kept(_Outer, ("scene",), make)
    kept(_Outer, ("scene",), make, lambda found: found.inner.rows.shape == (2, 3))
    assert make.calls == 1
    kept(_Outer, ("scene",), make, lambda found: found.inner.rows.shape == (2, 4))
    assert make.calls == 2 and len(list(cache.glob("*.arrays"))) == 1


def test_a_whole_file_under_another_name_is_not_used(cache: Path) -> None:
    make = _Maker()
    kept(_Outer, (1,), make)
    (first,) = cache.glob("*.arrays")
    content = first.read_bytes()
    kept(_Outer, (2,), make)
    (second,) = {*cache.glob("*.arrays")} - {first}
    second.write_bytes(content)
    kept(_Outer, (2,), make)
    assert make.calls == 3


def _sealed(path: Path, content: bytes) -> bytes:
    return hashlib.sha256(path.stem.encode() + content).digest() + content


@pytest.mark.parametrize(
    "content",
    [
        b"", b"{}", b"[]\n", b"[[[[", b'[["name","|O",[1]]]\n' + bytes(8), b'[["name","<i8",[-1]]]\n' + bytes(8),
        b'[["name","<f8",[1000000000000]]]\n', b'[["name","<f8",[1000000000000,1000000000000]]]\n' + bytes(64),
        b"[" * 100_000 + b"\n", b'[["name","<i8",[1e3]]]\n', b'[["other","<i8",[1]]]\n' + bytes(8),
        b"\x80\x04\x95\n", b'[["name","<i8",[1]]]\n' + bytes(9), b"PK\x03\x04" + bytes(100),
    ],
)  # fmt: skip
def test_a_forged_file_is_made_again(cache: Path, content: bytes) -> None:
    """With a digest that fits: no pickles, no more memory than it has bytes, no error."""
    make = _Maker()
    first = kept(_Outer, ("scene",), make)
    (path,) = cache.glob("*.arrays")
    path.write_bytes(_sealed(path, content))
    assert _same(kept(_Outer, ("scene",), make), first) and make.calls == 2


def test_files_that_others_could_write_are_not_believed(
    cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    make = _Maker()
    kept(_Outer, (1,), make)
    (path,) = cache.glob("*.arrays")
    assert path.stat().st_mode & 0o777 == 0o600
    path.chmod(0o620)
    kept(_Outer, (1,), make)
    assert make.calls == 2 and path.stat().st_mode & 0o777 == 0o600
    link = path.with_name("elsewhere")
    path.rename(link)
    path.symlink_to(link)
    kept(_Outer, (1,), make)
    assert make.calls == 3 and not path.is_symlink()
    path.unlink()
    os.mkfifo(path, 0o600)
    assert _same(kept(_Outer, (1,), make), make()) and make.calls == 5
    monkeypatch.setattr(os, "geteuid", lambda: 12345)
    kept(_Outer, (1,), make)  # a name of one's own
    assert make.calls == 6
    own = {p for p in cache.iterdir() if p.stat().st_size and p != path} - {link}
    assert len(own) == 1
    kept(_Outer, (1,), make)  # of root, for another user: believed
    assert make.calls == (6 if own.pop().stat().st_uid == 0 else 7)


def test_without_a_home_or_a_readable_folder_everything_goes_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    make = _Maker()

    def no_home() -> Path:
        raise RuntimeError("Could not determine home directory.")

    monkeypatch.delenv("SOUNDSPACES_SIM_CACHE")
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    monkeypatch.setattr(Path, "home", no_home)
    kept(_Outer, ("scene",), make)
    with pytest.raises(ss.ConfigError, match="set SOUNDSPACES_SIM_CACHE"):
        cache_root()
    monkeypatch.setenv("SOUNDSPACES_SIM_CACHE", str(tmp_path))
    kept(_Outer, ("scene",), make)
    real = os.open

    def denied(path: Any, *args: Any, **named: Any) -> int:
        if str(path).startswith(str(tmp_path)):
            raise PermissionError(13, "Permission denied", str(path))
        return real(path, *args, **named)

    monkeypatch.setattr(os, "open", denied)
    kept(_Outer, ("scene",), make)
    assert make.calls == 3
    monkeypatch.undo()


def test_a_cache_that_is_only_read_serves(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    make = _Maker()
    kept(_Outer, ("scene",), make)

    def read_only(*_: Any, **__: Any) -> None:
        raise OSError(30, "Read-only file system")

    monkeypatch.setattr(os, "utime", read_only)
    kept(_Outer, ("scene",), make)
    assert make.calls == 1 and cache.is_dir()


def test_fingerprints_tell_types_and_shapes_apart() -> None:
    a = np.zeros((2, 3))
    alike = [a, a.reshape(3, 2), a.astype(np.int64), np.zeros((2, 3, 1))]
    assert len({fingerprint(x) for x in alike}) == 4 and fingerprint(a) == fingerprint(a.copy("F"))


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
    (path,) = cache.glob("*.arrays")
    monkeypatch.setattr(module, "_MOST", 3 * path.stat().st_size)
    os.utime(path, (5, 5))
    for k in (1, 2):
        before = {*cache.glob("*.arrays")}
        kept(_Outer, (k,), make)
        (new,) = {*cache.glob("*.arrays")} - before
        os.utime(new, (k, k))  # 1 is the oldest, then 2, then 0
    kept(_Outer, (1,), make)  # used again: now 2 is
    kept(_Outer, (3,), make)
    assert make.calls == 4 and len(list(cache.glob("*.arrays"))) == 3
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
    # scattering by size, closed solids, specular planes, wedges, patches, transfer subpaths
    assert len(list(cache.glob("*.arrays"))) == 6
    again = run(0, scattering="size")
    assert len(list(cache.glob("*.arrays"))) == 6
    np.testing.assert_array_equal(first.energy, again.energy)
    np.testing.assert_array_equal(first.relative_error, again.relative_error)
    run(1, scattering="size")  # other subpaths
    assert len(list(cache.glob("*.arrays"))) == 7
    run(0, scattering="table")  # other patches and subpaths; planes and wedges are as before
    assert len(list(cache.glob("*.arrays"))) == 9
