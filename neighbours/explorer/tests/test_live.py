"""A scene that is simulated while one listens: its answers are the engine's own."""

from __future__ import annotations

import dataclasses
import shlex
import subprocess
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import soundspaces_parameters
from msgspec import structs
from soundspaces_explorer.absorption import chosen_table, materials_file, with_absorption
from soundspaces_explorer.job import JobMaker
from soundspaces_explorer.live import Answer, LiveScene, NotYetError, Question, Step

import soundspaces_sim as ss
from soundspaces_sim.parts import prepare_scene

A, B, C = (1.0, 1.0, 1.5), (4.0, 3.5, 1.5), (4.5, 3.0, 1.5)
CHOSEN = (("carpet", (0.5, 0.5, 0.5, 0.5)),)


def _ask_to_the_end(live: LiveScene, question: Question) -> list[Answer]:
    """All answers until the last estimate."""
    found = [live.ask(question, wait_s=120.0)]
    while not found[-1].done:
        found.append(live.ask(question, found[-1].version, 120.0))
        assert found[-1].version > found[-2].version, "no answer within two minutes"
    return found


@contextmanager
def _resting(live: LiveScene) -> Iterator[None]:
    """Its threads take no new estimate meanwhile."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(LiveScene, "_next", lambda *_: None)
        yield
    with live._changed:
        live._changed.notify_all()


def _simulated(live: LiveScene, scene: ss.Scene, question: Question, step: Step) -> ss.Echogram:
    """What the package's own `simulate` gives for a step."""
    config = structs.replace(
        live.config,
        walks=step.walks,
        radiance_transfer=ss.RadianceTransferConfig(enabled=step.transfer, subpaths="own"),
        materials=ss.MaterialsConfig(enabled=True, groups=12),
    )
    return ss.simulate(scene, question.source, question.listener, config)[0, 0]


def test_estimates_are_those_of_simulate_and_sharpen(
    live_scene: LiveScene, few_steps: tuple[Step, ...]
) -> None:
    question = Question(A, B)
    answers = [a for a in _ask_to_the_end(live_scene, question) if a.kind == "estimate"]
    assert answers[-1].step == len(few_steps) - 1
    for answer in answers:
        wanted = _simulated(live_scene, live_scene.scene, question, few_steps[answer.step])
        np.testing.assert_array_equal(answer.echogram.energy, wanted.energy)
        np.testing.assert_array_equal(answer.echogram.early.delay, wanted.early.delay)
    last = answers[-1]
    expected = soundspaces_parameters.room_parameters(wanted, ("t30", "c50", "sti"), "stored")
    np.testing.assert_allclose(last.measures["t30"][:, 0], expected["t30"][0], rtol=1e-12)
    np.testing.assert_allclose(last.measures["sti"][0, 0], expected["sti"][0, 0], rtol=1e-12)
    assert np.isfinite(last.measures["c50"]).all() and (last.measures["c50"][:, 1] > 0.0).all()
    again = live_scene.ask(question)
    assert again.done and again.kind == "estimate"


def test_a_place_walked_to_has_its_own_arrivals_at_once(
    live_scene: LiveScene, few_steps: tuple[Step, ...]
) -> None:
    """Before it is estimated: arrivals of the place itself, reverberation of the place before."""
    before = _ask_to_the_end(live_scene, Question(A, B))[-1]
    question = Question(A, C)
    with _resting(live_scene):
        answer = live_scene.ask(question)
    assert answer.kind == "moved" and not answer.done
    wanted = _simulated(live_scene, live_scene.scene, question, few_steps[0])
    assert answer.echogram.direct is not None and wanted.direct is not None
    assert answer.echogram.direct.delay == pytest.approx(np.linalg.norm(np.subtract(A, C)) / 343.0)
    np.testing.assert_allclose(answer.echogram.direct.energy, wanted.direct.energy, rtol=1e-6)
    np.testing.assert_allclose(np.sort(answer.echogram.early.delay), np.sort(wanted.early.delay))
    np.testing.assert_array_equal(answer.echogram.energy, before.echogram.energy)


def test_other_absorption_is_read_from_counts_and_then_simulated(
    live_scene: LiveScene, few_steps: tuple[Step, ...]
) -> None:
    plain, question = Question(A, B), Question(A, B, CHOSEN)
    before = _ask_to_the_end(live_scene, plain)[-1].echogram
    with _resting(live_scene):
        at_once = live_scene.ask(question)
    assert at_once.kind == "counts"
    wanted = ss.refurnished(before, {"carpet": 0.5}, force=True)
    np.testing.assert_array_equal(at_once.echogram.energy, wanted.energy)
    last = _ask_to_the_end(live_scene, question)[-1]
    assert last.kind == "estimate"
    scene = live_scene.scene
    table, carpet = scene.materials, scene.materials.index("carpet")
    absorption = np.where(np.arange(len(table.names))[:, None] == carpet, 0.5, table.absorption)
    other = dataclasses.replace(scene, materials=dataclasses.replace(table, absorption=absorption))
    simulated = _simulated(live_scene, other, question, few_steps[-1])
    np.testing.assert_allclose(last.echogram.histogram(), simulated.histogram(), rtol=1e-3, atol=1e-9)
    assert (simulated.histogram().sum(axis=1) < 0.95 * before.histogram().sum(axis=1)).any()


def test_a_table_and_its_file_have_the_absorption_that_was_chosen(tmp_path: Path) -> None:
    scene = ss.load_scene("demo")
    bands, chosen = ss.SimulationConfig().bands, {"carpet": np.array([0.1, 0.2, 0.3, 0.4])}
    changed = with_absorption(scene, chosen, bands).materials
    absorption, scattering, _ = changed.in_bands(bands)
    before = scene.materials.in_bands(bands)
    row, old = changed.index("carpet"), scene.materials.index("carpet")
    np.testing.assert_allclose(absorption[row], chosen["carpet"], rtol=1e-5)
    np.testing.assert_allclose(scattering[row], before[1][old], rtol=1e-5)
    np.testing.assert_allclose(
        absorption[changed.index("glass")], before[0][scene.materials.index("glass")], rtol=1e-9
    )
    file = tmp_path / "materials.toml"
    file.write_text(materials_file(chosen_table(scene.materials, chosen, bands)))
    read = ss.load_scene("demo", materials=file).materials
    np.testing.assert_allclose(
        read.in_bands(bands)[0][read.index("carpet")], chosen["carpet"], rtol=1e-5
    )


def test_a_job_is_written_once_and_its_command_is_one(
    live_scene: LiveScene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    told: list[Any] = []

    def run(command: list[str], **_: Any) -> subprocess.CompletedProcess[str]:
        told.append(command)
        line = '{"points": 9, "pairs": 81, "duration": 1, "bytes": 5, "core_hours": 2, "least_core_hours": 1}'
        return subprocess.CompletedProcess(command, 0, line, "")

    monkeypatch.setattr(subprocess, "run", run)
    options = {"unit": "m", "ceiling": False, "strict_materials": True, "up": None}
    jobs = JobMaker(live_scene.scene, "my room.obj", options, tmp_path, live_scene.bands)
    assert jobs.forecast() == {"state": "none"}
    first = jobs.write(0.5, CHOSEN)
    words = shlex.split(first["command"])
    assert words[:3] == ["soundspaces-sim", "rirs", "my room.obj"]
    assert {"--unit", "m", "--no-ceiling", "--strict-materials"} <= set(words) and "--up" not in words
    settings = ss.load_config(words[words.index("--config") + 1])
    assert settings.grid.spacing == 0.5 and settings.simulation.materials.enabled
    file = words[words.index("--materials") + 1]
    read = ss.load_scene("demo", materials=file).materials
    np.testing.assert_allclose(read.in_bands(live_scene.bands)[0][read.index("carpet")], 0.5, rtol=1e-5)
    assert jobs.write(0.5, CHOSEN)["files"] == first["files"]
    other = jobs.write(1.0, ())
    assert other["files"] == [str(tmp_path / "shoebox_2.toml")] and "--materials" not in other["command"]
    until = time.monotonic() + 30.0
    while jobs.forecast()["state"] != "known":
        assert time.monotonic() < until
        time.sleep(0.01)
    assert jobs.forecast()["pairs"] == 81 and told[0][4] == "plan"
    with pytest.raises(ss.ConfigError, match="spacing"):
        jobs.write(float("nan"), ())


class _Compiling:
    """Stands for children that compile, until they are let go."""

    def __init__(self) -> None:
        self.go, self.first = threading.Event(), threading.Event()

    def wait_for_first(self) -> None:
        assert self.first.wait(60.0)

    def wait(self, tell: Any) -> None:
        tell(400, 1000)
        assert self.go.wait(60.0)


def test_while_kernels_are_compiled_the_page_is_told(
    live_scene: LiveScene, few_steps: tuple[Step, ...]
) -> None:
    assert few_steps
    compiling: Any = _Compiling()
    waiting = LiveScene(live_scene.scene, live_scene.config, compiling=compiling)
    source, listener, storey = waiting.first_places()
    assert storey == 0 and not np.array_equal(source, listener)
    with pytest.raises(NotYetError, match=r"Compiling.* 40 %"):
        waiting.ask(Question(A, B), wait_s=0.2)
    compiling.first.set()
    first = waiting.ask(Question(A, B), wait_s=60.0)
    assert first.kind == "preview" and not first.done and "Compiling" in str(waiting.compiling)
    with pytest.raises(
        NotYetError
    ):  # arrivals of another place are not solved yet: its own preview comes first
        waiting.ask(Question(A, C), wait_s=0.0)
    assert waiting.ask(Question(A, C), wait_s=60.0).kind == "preview"
    waiting.ask(Question(A, B), wait_s=60.0)
    compiling.go.set()
    later = waiting.ask(Question(A, B), first.version + 2, 60.0)
    while later.kind == "preview":
        later = waiting.ask(Question(A, B), later.version, 60.0)
    assert later.kind == "estimate" and not waiting.compiling
    waiting.close()
    before, after = first.echogram, later.echogram
    assert before.visible and len(before.early) == 0 < len(after.early)
    assert before.direct is not None and after.direct is not None
    np.testing.assert_allclose(before.direct.energy, after.direct.energy, rtol=1e-6)
    early = sum(arrival.energy for arrival in after.early)
    late, whole = (e.histogram().sum(axis=1) for e in (before, after))
    np.testing.assert_allclose(late + early, whole, rtol=0.3)


def test_a_place_is_heard_while_later_estimates_are_prepared(
    live_scene: LiveScene, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Patches of radiance transfer take seconds in a scan."""
    go, waited_in_vain = threading.Event(), []

    def slowly(scene: ss.Scene, config: ss.SimulationConfig) -> Any:
        if config.radiance_transfer.enabled and not go.wait(60.0):
            waited_in_vain.append(config)
        return prepare_scene(scene, config)

    monkeypatch.setattr("soundspaces_explorer.live.prepare_scene", slowly)
    walked = LiveScene(live_scene.scene, live_scene.config)
    assert walked.ask(Question(A, B), wait_s=120.0).kind == "estimate"
    answer = walked.ask(Question(A, C))
    go.set()
    assert answer.kind == "moved" and not waited_in_vain
    walked.close()


def test_a_storey_from_above() -> None:
    """A room of 6 m by 5 m with a table of 1 m by 2 m, .75 m high, in it."""
    walls = dict.fromkeys(("west", "east", "south", "north", "ceiling"), "gypsum-board")
    room = ss.shoebox((6.0, 5.0, 3.0), {**walls, "floor": "carpet"})
    corners = [[x, y, 0.75] for x in (2.0, 3.0) for y in (1.0, 3.0)]
    faces = len(room.vertices) + np.array([[0, 1, 2], [2, 1, 3]])
    wood = room.materials.index("wood-thick")
    scene = ss.Scene(
        np.concatenate([room.vertices, corners]),
        np.concatenate([room.faces, faces]),
        np.concatenate([room.face_material, [wood, wood]]),
        room.materials,
    )
    seen = LiveScene(scene)
    cell, material, height = seen.from_above(0)
    seen.close()
    assert material.shape == (round(5.0 / cell), round(6.0 / cell))
    table, floor = material == wood, material == room.materials.index("carpet")
    assert (table | floor).all()
    y, x = np.nonzero(table)
    assert table.sum() * cell**2 == pytest.approx(2.0, rel=0.05)
    assert (x.min() * cell, y.min() * cell) == pytest.approx((2.0, 1.0), abs=2 * cell)
    np.testing.assert_allclose(height[table], 0.75, atol=1e-5)
    np.testing.assert_allclose(height[floor], 0.0, atol=1e-5)
    with pytest.raises(ss.PointError, match="storey 1"):
        seen.from_above(1)


def test_what_cannot_be_asked(live_scene: LiveScene) -> None:
    for question, error in (
        (Question((50.0, 1.0, 1.5), B), ss.PointError),
        (Question(A, B, (("velvet", (0.1,) * 4),)), ss.MaterialError),
        (Question(A, B, (("carpet", (0.1, 0.2)),)), ss.MaterialError),
        (Question(A, B, (("carpet", (float("nan"),) * 4),)), ss.MaterialError),
    ):
        with pytest.raises(error):
            live_scene.ask(question)
    with pytest.raises(ss.PointError, match="nobody can stand"):
        live_scene.place(-4.0, 1.0, 0)
    with pytest.raises(ss.PointError, match="storey"):
        live_scene.place(1.0, 1.0, 3)
    with pytest.raises(ss.ConfigError, match="waves"):
        LiveScene(live_scene.scene, ss.SimulationConfig(low=ss.LowConfig(method="waves")))
