"""`PathTracedAcoustics` against isaac-audio-sensors' interface, by stand-ins of its records: that package is not among
the tests' (README.md says how it was run with the genuine one)."""

from __future__ import annotations

import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest
import soundfile
from soundspaces_isaac import PathTracedAcoustics
from soundspaces_rlr.errors import RlrError

from soundspaces_sim.scene.build import shoebox

RATE = 16000
LOCAL = [(0.05, 0.0, 0.0), (-0.05, 0.0, 0.0)]


@pytest.fixture
def package(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two functions of the package: places of an array that is not turned, and a block that keeps its fields."""
    arrays, types = ModuleType("microphone_array"), ModuleType("types")
    vars(arrays)["microphone_world_positions"] = lambda array: {
        m.mic_id: np.add(array.position_world, m.relative_position_m) for m in array.microphones
    }
    vars(types)["MicrophoneSignalBlock"] = SimpleNamespace
    for name, module in (
        ("", ModuleType("isaac_audio_sensors")),
        (".core", ModuleType("core")),
        (".core.microphone_array", arrays),
        (".core.types", types),
    ):
        monkeypatch.setitem(sys.modules, f"isaac_audio_sensors{name}", module)


def snapshot(path: Path, position: tuple[float, float, float] = (4.0, 3.0, 1.5), **source: Any) -> Any:
    fields = {
        "source_id": "s", "audio_asset_path": str(path), "position_world": position, "start_time_s": 0.1, "duration_s": None,
        "gain_db": -6.0, "loop_count": 0, "directivity": "omni",
    }  # fmt: skip
    microphones = [
        SimpleNamespace(
            mic_id=f"m{i}", relative_position_m=p, gain_db=0.0, directivity="omni", self_noise_db=None
        )
        for i, p in enumerate(LOCAL)
    ]
    array = SimpleNamespace(position_world=(2.0, 2.0, 1.2), microphones=microphones, sample_rate_hz=RATE)
    return SimpleNamespace(
        sources=[SimpleNamespace(**(fields | source))], stage_id="stage", array_by_id=lambda _: array
    )


def window(start: float, end: float) -> Any:
    return SimpleNamespace(start_time_s=start, end_time_s=end, frame_index=0)


@pytest.fixture
def sound(tmp_path: Path) -> Path:
    path = tmp_path / "x.wav"
    noise = 0.1 * np.random.default_rng(0).standard_normal(RATE // 4)
    soundfile.write(path, noise, RATE, subtype="FLOAT")
    return path


@pytest.mark.usefixtures("package")
def test_the_direct_sound_is_late_and_falls_with_distance(sound: Path) -> None:
    """Spectra below 2 kHz are those of the file by -6 dB / (4 pi r), from 0.1 s + r / c on, with silence before."""
    block = PathTracedAcoustics(shoebox([6, 5, 3], 0.3), indirect=False).propagate(
        snapshot(sound), "a", window(0.0, 0.6)
    )
    signal, _ = soundfile.read(sound)
    assert (block.samples.dtype.name, block.samples.shape) == ("float32", (2, round(0.6 * RATE)))
    assert block.microphone_ids == ("m0", "m1") and block.producer_id == "soundspaces_sim"
    for channel, local in zip(block.samples, LOCAL, strict=True):
        r = float(np.linalg.norm(np.subtract((4.0, 3.0, 1.5), np.add((2.0, 2.0, 1.2), local))))
        onset = (0.1 + r / 343.0) * RATE
        assert np.abs(channel[: int(onset) - 9]).max() < 1e-6
        whole, own = (np.fft.rfft(x, len(channel)) for x in (channel, signal))
        f = np.fft.rfftfreq(len(channel), 1 / RATE)
        low = (f > 300) & (f < 2000)
        gain = np.sqrt((np.abs(whole[low]) ** 2).sum() / (np.abs(own[low]) ** 2).sum())
        assert gain == pytest.approx(10 ** (-0.3) / (4 * np.pi * r), rel=0.02)


@pytest.mark.usefixtures("package")
def test_windows_fit_together_and_motion_is_told(sound: Path) -> None:
    """Two windows are one longer one; a source that has moved is a discontinuity; loops and durations end it."""
    backend = PathTracedAcoustics(shoebox([6, 5, 3], 0.3, 0.2))
    whole = backend.propagate(snapshot(sound), "a", window(0.1, 0.5))
    parts = [backend.propagate(snapshot(sound), "a", window(*w)) for w in ((0.1, 0.3), (0.3, 0.5))]
    np.testing.assert_allclose(
        np.concatenate([p.samples for p in parts], axis=1), whole.samples, atol=1e-6
    )
    assert not any(p.discontinuity for p in (whole, *parts))
    assert backend.propagate(snapshot(sound, (3.0, 3.0, 1.5)), "a", window(0.5, 0.6)).discontinuity
    direct = PathTracedAcoustics(shoebox([6, 5, 3], 0.3), indirect=False)
    late = window(0.45, 0.5)  # after one round of a quarter of a second, with its way
    assert np.abs(direct.propagate(snapshot(sound), "a", late).samples).max() < 1e-6
    assert direct.propagate(snapshot(sound, loop_count=-1), "a", late).samples.any()
    ended = snapshot(sound, loop_count=-1, duration_s=0.1)
    assert np.abs(direct.propagate(ended, "a", late).samples).max() < 1e-6


@pytest.mark.usefixtures("package")
def test_what_is_not_modelled_is_refused(sound: Path, tmp_path: Path) -> None:
    backend = PathTracedAcoustics(shoebox([6, 5, 3], 0.3))
    for source, message in (
        (snapshot(sound, directivity="cardioid"), "cardioid"),
        (snapshot(sound, audio_asset_path="generated://pulse"), "sound file"),
        (snapshot(tmp_path / "no.wav"), "no.wav"),
        (snapshot(sound, (9.0, 3.0, 1.5)), "outside"),
    ):
        with pytest.raises(RlrError, match=message):
            backend.propagate(source, "a", window(0.0, 0.6))
    with pytest.raises(TypeError, match="Scene"):
        PathTracedAcoustics("demo")  # type: ignore[arg-type]
