"""What only some systems have is asked for, not assumed: the package without it, with stand-ins for Windows'
own."""

from __future__ import annotations

import ctypes
import errno
import json
import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from soundspaces_sim.core import embree_library, platforms
from soundspaces_sim.core.errors import SceneError
from tests.marks import ci_slow

ROOT = Path(__file__).resolve().parents[2]

# A system without what Windows has not: modules, names of `os`. What others need of it is loaded before.
_WINDOWS = """
import asyncio, concurrent.futures, hashlib, importlib, json, multiprocessing, pkgutil, random, shutil, socket
import subprocess, sys, tempfile, threading, types, typing, uuid, os
import h5py, loky, matplotlib, networkx, numba, numpy, rich, scipy.signal, soundfile, trimesh, typer, psutil
import fsspec, jinja2, msgspec, threadpoolctl, llvmlite.binding, PIL.Image, matplotlib.pyplot
for name in ("distributed", "submitit", "gymnasium", "collada", "sofar", "pandas", "pyarrow.parquet", "webdataset",
             "websockets", "fast_simplification", "torch", "ray", "ifcopenshell", "playwright", "openpyxl"):
    try:
        importlib.import_module(name)
    except ImportError:
        pass  # an extra
locked = []
class Own:
    NAMES = {"fcntl", "resource", "pwd", "grp", "termios", "posix"}
    def find_spec(self, name, path=None, target=None):
        if name in self.NAMES:
            raise ImportError(f"{name} on Windows")
sys.meta_path.insert(0, Own())
for name in Own.NAMES:
    sys.modules.pop(name, None)
for name in ("register_at_fork", "geteuid", "getuid", "sysconf", "sync", "O_NOFOLLOW", "O_CLOEXEC", "O_NONBLOCK",
             "O_DIRECTORY", "posix_fallocate", "sched_getaffinity", "fork", "killpg", "setsid"):
    if hasattr(os, name):
        delattr(os, name)
stand_in = types.ModuleType("msvcrt")
stand_in.LK_LOCK, stand_in.LK_UNLCK = 1, 0
stand_in.locking = lambda handle, mode, count: locked.append(mode)
sys.modules["msvcrt"] = stand_in
import soundspaces_sim as ss
from soundspaces_sim.core import platforms
optional = {"torch", "ray", "submitit", "ifcopenshell", "distributed", "dask", "collada", "websockets", "gymnasium"}
failed, count = [], 0
for module in pkgutil.walk_packages(ss.__path__, "soundspaces_sim."):
    if ".distribution" in module.name or module.name.endswith("__main__"):
        continue
    try:
        importlib.import_module(module.name)
        count += 1
    except ImportError as error:
        if (error.name or "").split(".")[0] not in optional:
            failed.append((module.name, str(error)))
from soundspaces_sim.core.io.files import publish
from soundspaces_sim.core.io.untrusted import read_bytes
from soundspaces_sim.core.memory import free_memory
from pathlib import Path
folder = Path(sys.argv[2])
publish(folder / "a", b"abc")
platforms.sync_all()
os.symlink(folder / "a", folder / "link")
try:
    read_bytes(folder / "link", ss.DatasetError, "file", 10, follow=False)
    failed.append(("link", "was followed"))
except ss.DatasetError as error:
    assert "symbolic link" in str(error), error
with platforms.exclusive(folder / "part") as file:
    platforms.reserve(file.fileno(), 10**6)
    file.write(b"xyz")
    platforms.rename_open(file, folder / "part", folder / "whole")
assert (folder / "whole").read_bytes() == b"xyz" and locked == [1, 0], locked
import psutil
psutil.Process = lambda: types.SimpleNamespace(memory_info=lambda: types.SimpleNamespace(peak_wset=3e6))
assert platforms.peak_memory_mb() == 3.0 and 1e6 < free_memory() < 1e14 and platforms.user_name()
sys.platform = "win32"
assert platforms.process_runs(os.getpid()) and not platforms.process_runs(2**22 + 12345)
sys.platform = "linux"
with ss.open_dataset(sys.argv[1]) as ds:
    got = ds.parameters("c80", pairs=[(0, 3)])["c80"]
    made = ds.binaural(0, 1).shape
print(json.dumps([failed, count, got.tolist(), made]))
"""


@ci_slow
def test_the_package_on_a_system_without_posix(dataset_folder: Path, tmp_path: Path) -> None:
    """Every module is imported, files are written, locked and read, a dataset is opened and rendered."""
    done = subprocess.run(
        [sys.executable, "-c", _WINDOWS, str(dataset_folder), str(tmp_path)],
        cwd=ROOT,
        capture_output=True,
        text=True,
        env={**os.environ, "SOUNDSPACES_SIM_CACHE": str(tmp_path / "cache"), "USERNAME": "somebody"},
    )
    assert done.returncode == 0, done.stderr[-3000:]
    failed, count, values, shape = json.loads(done.stdout.splitlines()[-1])
    modules = sum(1 for _ in (ROOT / "soundspaces_sim").rglob("*.py"))
    assert failed == [] and count > 0.95 * modules, (failed, count, modules)  # some need an extra
    assert np.isfinite(values).all() and shape[0] == 2


def test_what_systems_lack_is_imported_in_one_place_alone() -> None:
    """Modules of one system stand in core/platforms.py, by name."""
    own = "fcntl|resource|pwd|grp|termios|msvcrt|winreg|_winapi|posix"
    for path in (ROOT / "soundspaces_sim").rglob("*.py"):
        found = re.findall(rf"^\s*(?:import|from) (?:{own})\b", path.read_text("utf-8"), re.MULTILINE)
        assert not found, (path, found)


@pytest.mark.skipif(not hasattr(os, "posix_fallocate"), reason="this system cannot be asked to")
def test_room_on_the_disk_is_set_aside(tmp_path: Path) -> None:
    with open(tmp_path / "table", "wb") as file:
        platforms.reserve(file.fileno(), 10**6)
        assert 512 * os.fstat(file.fileno()).st_blocks >= 10**6


def test_a_lock_of_windows_is_waited_for() -> None:
    """Its call gives up after ten seconds, and is made again; other errors are raised."""
    calls = []

    class Stand:
        LK_LOCK = 1

        @staticmethod
        def locking(_handle: int, mode: int, _count: int) -> None:
            calls.append(mode)
            if len(calls) < 3:
                raise OSError(errno.EDEADLK, "resource deadlock avoided")
            if len(calls) > 3:
                raise OSError(errno.EBADF, "no such handle")

    with open(os.devnull, "rb") as guard:
        platforms._lock(Stand, guard)
        assert calls == [1, 1, 1]
        with pytest.raises(OSError, match="no such handle"):
            platforms._lock(Stand, guard)


_HITS = """
import sys, json, hashlib, numpy as np
from soundspaces_sim.core import embree_library
from soundspaces_sim.scene.rays.embree import RayScene, intersect
from numba import njit
import soundspaces_sim as ss
@njit
def cast(handle, o, d, out):
    for i in range(len(o)):
        t, face = intersect(handle, (o[i, 0], o[i, 1], o[i, 2]), (d[i, 0], d[i, 1], d[i, 2]), np.inf)
        out[i, 0], out[i, 1] = t, face
rng = np.random.default_rng(0)
vertices = rng.normal(size=(600, 3))
rays = RayScene(vertices, np.arange(600).reshape(200, 3))
o, d = rng.normal(size=(2, 20000, 3))
d /= np.linalg.norm(d, axis=1, keepdims=True)
out = np.empty((20000, 2))
cast(rays.handle, o, d, out)
print(json.dumps([embree_library.embree_version(), hashlib.sha256(out.tobytes()).hexdigest(), int((out[:, 1] >= 0).sum())]))
"""


def _library() -> Path:
    """The Embree that embreex brings, as a file of its own."""
    import embreex

    found = sorted(Path(embreex.__file__).parent.with_name("embreex.libs").glob("libembree4*"))
    if not found:
        pytest.skip("embreex brings no library of its own on this system")
    return found[0]


@ci_slow  # compiles two kernels for itself
def test_a_library_of_the_system_hits_the_same() -> None:
    """Embree 4 by its file, as where there is no embreex: the same bits for 20,000 rays among random
    triangles."""
    found = []
    for given in ({}, {embree_library.VARIABLE: str(_library())}):
        done = subprocess.run(
            [sys.executable, "-c", _HITS],
            cwd=ROOT,
            capture_output=True,
            text=True,
            env={**os.environ, **given},
        )
        assert done.returncode == 0, done.stderr[-2000:]
        found.append(json.loads(done.stdout))
    assert found[0] == found[1] and found[0][0].startswith("Embree 4.") and found[0][2] > 5000


def test_no_embree_is_told(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    load = embree_library.load_embree.__wrapped__
    monkeypatch.setenv(embree_library.VARIABLE, str(tmp_path / "absent.so"))
    with pytest.raises(
        SceneError, match=r"absent\.so: this is no library of Embree.*apt install libembree4-4"
    ):
        load()
    monkeypatch.delenv(embree_library.VARIABLE)
    monkeypatch.setattr(embree_library, "_of_embreex", lambda: None)
    monkeypatch.setattr(embree_library, "find_library", lambda _: None)
    with pytest.raises(SceneError, match="rays need Embree 4, which this machine does not have"):
        load()


def test_an_older_embree_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    """The wheels of Intel macs bring Embree 2."""

    class Older:
        class rtcNewDevice:  # noqa: N801
            restype: object = None

            def __new__(cls, *_: object) -> int:  # type: ignore[misc]
                return 1

        rtcReleaseDevice = staticmethod(lambda _: None)  # noqa: N815

        class rtcGetDeviceProperty:  # noqa: N801
            restype: object = None

            def __new__(cls, *_: object) -> int:  # type: ignore[misc]
                return 21707

    monkeypatch.setattr(ctypes, "CDLL", lambda _: Older)
    with pytest.raises(SceneError, match=r"expected Embree 4, got version 2\.1707"):
        embree_library.load_embree.__wrapped__()


def test_windows_finds_the_library_beside_the_package(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """embreex.libs/embree4.dll, as the wheel for Windows lays it, goes before the extension."""
    package = tmp_path / "embreex"
    package.mkdir()
    (package / "__init__.py").touch()
    (package / "rtcore_scene.cp311-win_amd64.pyd").touch()
    (tmp_path / "embreex.libs").mkdir()
    dll = tmp_path / "embreex.libs" / "embree4.dll"
    dll.touch()
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.delitem(sys.modules, "embreex", raising=False)
    assert embree_library._of_embreex() == str(dll)
