"""The page on a receiver: which surfaces and edges reflections met, and what the page shows."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from soundspaces_parameters.registry import PARAMETERS
from soundspaces_pictures import commands as pictures
from soundspaces_receiver_page.page import Reflection, _line, edges_told, planes_told, reflections
from typer.testing import CliRunner

import soundspaces_sim as ss
from neighbours.parameters.tests.test_room_parameters import ds as ds
from neighbours.pictures.tests.test_report import _Page
from soundspaces_sim.cli.app import app
from soundspaces_sim.echogram.echogram import EDGE, KINDS, Arrivals
from tests.command_line import run_command


def test_reflections_have_surfaces(ds: ss.RirDataset) -> None:
    """Two rooms of 4 m x 4 m x 2.5 m side by side: first-order reflections come off their six planes and the wall
    between, and every corner lies on one; path lengths say so too."""
    s, l = ds.points[0], ds.points[3]
    found = ds.echogram(0, 3)
    planes = planes_told([(found, s, l)], 343.0)
    assert len(planes) >= 4
    walls = {0: (0.0, 4.0, 8.0), 1: (0.0, 4.0), 2: (0.0, 2.5)}
    for plane in planes.values():
        axis = int(np.abs(plane.normal).argmax())
        assert abs(plane.normal[axis]) > 0.999
        assert min(abs(plane.point[axis] - x) for x in walls[axis]) < 0.01
        legs = np.linalg.norm(plane.point - s) + np.linalg.norm(plane.point - l)
        assert np.abs(found.early.delay * 343.0 - legs).min() < 1e-3
    listed = reflections(found, s, l, planes, {}, 2, 343.0)
    assert [r.number for r in listed] == list(range(listed[0].number, listed[0].number + len(listed)))
    assert [r.delay for r in listed] == sorted(r.delay for r in listed)
    assert any("facing up at z = 0.00 m" in r.surfaces for r in listed)
    direct = [r for r in listed if r.number == 0]
    assert all(abs(r.azimuth) < 1e-6 and r.surfaces == "direct sound" for r in direct)


def _arrivals(*arrivals: tuple[float, int, tuple[int, int], tuple[int, int], bool]) -> Arrivals:
    """Of (delay, kind, planes, edges, whether it is heard)."""
    delay, kind, planes, edges, heard = zip(*arrivals, strict=True)
    energy = 1e-4 * np.array(heard, float)[:, None]
    direction = np.tile([1.0, 0.0, 0.0], (len(delay), 1))
    return Arrivals(
        np.array(delay), energy, direction, np.array(planes), np.array(kind), np.array(edges)
    )


def test_edges_are_told_by_their_places_and_numbers_have_no_gaps(ds: ss.RirDataset) -> None:
    edge, both = (
        KINDS.index(KINDS[EDGE]),
        next(k for k, name in enumerate(KINDS) if name.startswith("edge,")),
    )
    early = _arrivals(
        (0.03, edge, (-1, -1), (15, -1), True), (0.04, 0, (7, -1), (-1, -1), False),
        (0.05, both, (7, -1), (15, -1), True), (0.06, both, (7, -1), (16, -1), True),
    )  # fmt: skip
    found = replace(ds.echogram(0, 3), early=early, bands=(0.0, 1e4), direct=None)
    s, l = ds.points[0], ds.points[3]
    bends = edges_told([(found, s, l)], 343.0)
    place = "({:.2f}, {:.2f}, {:.2f}) m".format(*bends[15])
    listed = reflections(found, s, l, {}, bends, 0, 343.0)
    assert [r.number for r in listed] == [1, 2, 3]
    assert listed[0].surfaces == f"edge at {place}"
    assert listed[1].surfaces.startswith(f"edge through {place}, then a surface")
    assert listed[2].surfaces.startswith("an edge that no other path tells of, then")


@pytest.mark.parametrize(
    ("value", "text"), [(-0.3, "0"), (-0.6, "−1"), (0.0, "0"), (-0.0, "0"), (12.0, "12")]
)
def test_there_is_no_sign_before_nothing(value: float, text: str) -> None:
    line = _line(Reflection(0, 0.01, value, 179.9, value, ""), [Reflection(0, 0.01, 0.0, 0.0, 0.0, "")])
    assert line[6] == f"{text}°" and line[5] == "behind" and "−0.0" not in line[3:5]


def test_the_page_on_a_receiver(ds: ss.RirDataset, tmp_path: Path) -> None:
    """It has every parameter, every reflection with its surfaces, and loads and runs nothing."""
    out = tmp_path / "r.html"
    done = CliRunner().invoke(
        app,
        [
            "report",
            str(ds.path),
            "--receiver",
            "3",
            "--source",
            "0",
            "--out",
            str(out),
            "--noise",
            "40,40,40,35,30,25,20",
        ],
    )
    assert done.exit_code == 0, (done.output, done.exception)
    page = _Page(out.read_text("utf-8"))
    assert (
        "script" not in page.tags and len([x for x in page.loads if x.startswith("data:image/png")]) == 2
    )
    assert all(x.startswith("data:") for x in page.loads)
    for name in PARAMETERS:
        assert name in page.text
    for text in ("direct sound", "facing up at z = 0.00 m", "noise 40 40 40 35 30 25 20 dB", "±"):
        assert text in page.text, text
    assert page.text.count("surface facing") + page.text.count("edge") >= len(ds.echogram(0, 3).early)


def test_without_it_the_command_says_how_to_get_it(
    ds: ss.RirDataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    absent = pictures._RECEIVER_PAGE._replace(target="not_installed_here:write")
    monkeypatch.setattr(pictures, "_RECEIVER_PAGE", absent)
    command = ["report", str(ds.path), "--receiver", "3", "--out", str(tmp_path / "r.html")]
    done = run_command(*command, cwd=tmp_path)
    assert done.returncode == 2
    assert "./neighbours/pictures ./neighbours/receiver_page" in done.stderr
    assert not list(tmp_path.iterdir())
