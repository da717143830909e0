"""The README's Python runs as printed."""

import re
from pathlib import Path

import numpy as np
import pytest
import soundfile

import soundspaces_sim as ss
from tests.conftest import energy

README = Path(__file__).resolve().parents[1] / "README.md"


def test_examples_run_and_left_is_left(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    config = ss.JobConfig(
        grid=ss.GridConfig(spacing=1.0, rays=200),
        simulation=ss.SimulationConfig(walks=160, joined_walks=16, duration=0.3),
    )
    ss.build_dataset(ss.load_scene("demo"), "out", config)
    blocks = re.findall(r"```python\n(.*?)```", README.read_text(encoding="utf-8"), re.DOTALL)
    assert len(blocks) == 3
    for block in blocks:
        exec(block, {"__name__": "example"})
    ds = ss.open_dataset("out/demo")
    offset = ds.points[3] - ds.points[0]
    np.testing.assert_allclose(offset, [0.0, 3.0, 0.0], atol=1e-6)
    assert ds.echogram(3, 0).visible
    for heading, louder in ((0, 0), (180, 1)):
        ears, rate = soundfile.read(tmp_path / f"heading_{heading}.wav")
        assert rate == 44100 and ears.shape[1] == 2
        assert energy(ears.T)[louder] > 1.1 * energy(ears.T)[1 - louder]
