"""HRTF and directivity files of strangers: what is odd about one is said, in one error of ours."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest

import soundspaces_sim as ss
from soundspaces_sim.rendering.directivity import DirectivityError
from soundspaces_sim.rendering.hrtf import HrtfError, load_hrtf
from tests.attack.victims import _sphere

Change = Callable[[h5py.File], object]


def _head(path: Path, change: Change) -> Path:
    with h5py.File(path, "w") as sofa:
        sofa["Data.IR"] = np.random.default_rng(0).normal(size=(24, 2, 8))
        sofa["SourcePosition"] = _sphere(24)
        sofa["SourcePosition"].attrs["Type"] = "spherical"
        sofa["Data.SamplingRate"] = np.array([44100.0])
        change(sofa)
    return path


def _put(name: str, value: object) -> Change:
    def change(sofa: h5py.File) -> None:
        del sofa[name]
        sofa[name] = value

    return change


def _set(name: str, at: object, value: float) -> Change:
    def change(sofa: h5py.File) -> None:
        sofa[name][at] = value

    return change


_ONE = np.repeat(_sphere(24)[:1], 24, axis=0)
_FLAT = np.stack([np.arange(24) * 15.0, np.zeros(24), np.ones(24)], axis=1)
ODD: dict[str, tuple[Change, str]] = {
    "no responses": (lambda f: f.__delitem__("Data.IR"), "Data.IR' is missing"),
    "no positions": (lambda f: f.__delitem__("SourcePosition"), "SourcePosition' is missing"),
    "no rate": (lambda f: f.__delitem__("Data.SamplingRate"), "SamplingRate' is missing"),
    "one ear": (_put("Data.IR", np.ones((24, 1, 8))), "expected Data.IR of shape"),
    "no taps": (_put("Data.IR", np.ones((24, 2, 0))), "expected Data.IR of shape"),
    "four dimensions": (_put("Data.IR", np.ones((24, 2, 8, 1))), "expected Data.IR of shape"),
    "fewer positions": (_put("SourcePosition", _sphere(23)), "expected Data.IR of shape"),
    "NaN": (_set("Data.IR", (3, 0, 1), np.nan), "not finite"),
    "infinite": (_set("SourcePosition", (3, 0), np.inf), "not finite"),
    "huge": (_set("Data.IR", (3, 0, 1), 1e300), "beyond 1e6"),
    "silence": (_set("Data.IR", (3, 1), 0.0), "all zeros"),
    "rate of nought": (_put("Data.SamplingRate", [0.0]), "expected one Data.SamplingRate"),
    "negative rate": (_put("Data.SamplingRate", [-44100.0]), "expected one Data.SamplingRate"),
    "rate that is NaN": (_put("Data.SamplingRate", [np.nan]), "expected one Data.SamplingRate"),
    "two rates": (_put("Data.SamplingRate", [44100.0, 48000.0]), "expected one Data.SamplingRate"),
    "text": (_put("Data.IR", np.full((24, 2, 8), b"x")), "plain numbers"),
    "one direction": (_put("SourcePosition", _ONE), "different directions"),
    "a plane": (_put("SourcePosition", _FLAT), "in a plane"),
    "another type": (lambda f: f["SourcePosition"].attrs.__setitem__("Type", "hyperbolic"), "spherical or cartesian"),
    "a soft link": (lambda f: (f.move("Data.IR", "x"), f.__setitem__("Data.IR", h5py.SoftLink("/x"))), "link"),
    "an external link": (_put("Data.SamplingRate", h5py.ExternalLink("/etc/hostname", "x")), "link|missing"),
    "a million types": (lambda f: f["SourcePosition"].attrs.__setitem__("Type", ["spherical"] * 9), "one number or a text"),
}  # fmt: skip


@pytest.mark.parametrize("name", ODD)
def test_odd_heads(tmp_path: Path, name: str) -> None:
    change, words = ODD[name]
    with pytest.raises(HrtfError, match=words):
        load_hrtf(_head(tmp_path / "head.sofa", change))


def test_heads_that_are_no_files(tmp_path: Path) -> None:
    load_hrtf(_head(tmp_path / "head.sofa", lambda _: None))
    os.mkfifo(tmp_path / "pipe.sofa")
    (tmp_path / "text.sofa").write_text("x")
    for path in (tmp_path / "none.sofa", tmp_path, tmp_path / "pipe.sofa", tmp_path / "text.sofa"):
        with pytest.raises(HrtfError, match="cannot open this SOFA file"):
            load_hrtf(path)
        with pytest.raises(DirectivityError, match="cannot open this SOFA file"):
            ss.MeasuredDirectivity(path)
