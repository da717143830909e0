"""Where Embree's library is, and which version of it.

Embree 4 is one engine on every machine; what differs is who brings it. The embreex wheels do (Linux and Windows
on x86-64, macOS on Apple silicon). Elsewhere, as on Linux on Arm, it is the system's (Debian's and Ubuntu's
libembree4-4, conda-forge's or Homebrew's embree), and SOUNDSPACES_SIM_EMBREE names a file that goes before all.
"""

from __future__ import annotations

import ctypes
import logging
import os
from ctypes.util import find_library
from functools import cache
from importlib.util import find_spec
from pathlib import Path

from soundspaces_sim.core.errors import SceneError

VARIABLE = "SOUNDSPACES_SIM_EMBREE"
CHOICE = "SOUNDSPACES_SIM_RAYS"
_log = logging.getLogger(__name__)
_OLDEST, _NEWEST = 40000, 50000  # versions times 10,000: 4.0.0 up to 5
_VERSION = 0  # RTC_DEVICE_PROPERTY_VERSION
_HOW = (
    "install embreex (`pip install embreex`), or Embree 4 of the system (`apt install libembree4-4`, "
    f"`conda install -c conda-forge embree`, `brew install embree`), or set {VARIABLE} to the library's file"
)


def _of_embreex() -> str | None:
    """The file through which embreex's Embree can be reached: its own extension, which links it; on Windows,
    where a library's names are not those of what it links, the library itself."""
    spec = find_spec("embreex")
    if spec is None or not spec.submodule_search_locations:
        return None
    folder = Path(next(iter(spec.submodule_search_locations)))
    beside = sorted(
        [*folder.glob("embree4*.dll"), *folder.with_name("embreex.libs").glob("embree4*.dll")]
    )
    extensions = sorted([*folder.glob("rtcore_scene.*.so"), *folder.glob("rtcore_scene.so")])
    return next((str(path) for path in (*beside, *extensions)), None)


def _path() -> str | None:
    """The file of Embree's library, or of what links it; None if there is none."""
    return os.environ.get(VARIABLE) or _of_embreex() or find_library("embree4")


@cache
def ray_engine() -> str:
    """Who casts rays: ``embree``, or ``arrays`` (`scene.rays.hierarchy`), as the environment's SOUNDSPACES_SIM_RAYS
    says; by default (``auto``) Embree where there is one. Raises `SceneError` for any other word."""
    given = os.environ.get(CHOICE) or "auto"
    if given not in ("auto", "embree", "arrays"):
        raise SceneError(f"{CHOICE}: expected auto, embree or arrays, got {given!r}")
    if given != "auto":
        return given
    if _path() is not None:
        return "embree"
    _log.warning("no Embree 4 here: rays are cast by arrays, several times slower; for Embree %s", _HOW)
    return "arrays"


def ray_engine_name() -> str:
    """As ``Embree 4.4.0`` or ``arrays``: part of the key of what is kept of a scene."""
    return embree_version() if ray_engine() == "embree" else "arrays"


@cache
def load_embree() -> tuple[ctypes.CDLL, int]:
    """Embree's C interface and its version times 10,000. Raises `SceneError` if there is none, or of another
    version than 4."""
    path = _path()
    if path is None:
        raise SceneError(f"rays need Embree 4, which this machine does not have: {_HOW}")
    try:
        library = ctypes.CDLL(path)
        library.rtcNewDevice.restype = ctypes.c_void_p
        library.rtcGetDeviceProperty.restype = ctypes.c_ssize_t
    except (OSError, AttributeError) as error:
        raise SceneError(f"{path}: this is no library of Embree ({error}); {_HOW}") from error
    device = library.rtcNewDevice(ctypes.c_char_p(b"threads=1"))
    version = int(library.rtcGetDeviceProperty(ctypes.c_void_p(device), _VERSION))
    library.rtcReleaseDevice(ctypes.c_void_p(device))
    if not _OLDEST <= version < _NEWEST:
        raise SceneError(f"{path}: expected Embree 4, got version {version / 1e4:.4f}; {_HOW}")
    return library, version


def embree_version() -> str:
    """As ``Embree 4.4.0``."""
    _, version = load_embree()
    return f"Embree {version // 10000}.{version // 100 % 100}.{version % 100}"
