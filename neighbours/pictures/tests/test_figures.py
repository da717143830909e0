"""Pictures: their content, not their pixels; sounds to listen with; progress as log lines."""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pytest
import soundfile
from soundspaces_pictures import draw_lobes, interpolate, lobe
from soundspaces_pictures.field import band_field, field_levels
from soundspaces_pictures.listen import listening_folder
from soundspaces_pictures.lobes import moments
from soundspaces_pictures.pages import draw_page
from soundspaces_pictures.plot_data import load_plot_data
from soundspaces_renderers import dry

import soundspaces_sim as ss
from soundspaces_sim.dataset.format.floorplan import encode_floorplan, read_floorplan
from soundspaces_sim.echogram.echogram import Arrival, Arrivals
from soundspaces_sim.echogram.measures import levels_of
from soundspaces_sim.layout.floor_plan import make_floorplan
from soundspaces_sim.layout.grid import make_grid
from soundspaces_sim.layout.records import FloorPlan
from tests.command_line import run_command
from tests.marks import ci_slow
from tests.rooms import plain, table, two_rooms


def test_floor_plan_of_two_rooms(tmp_path: Path) -> None:
    """Walls of 8 x 4 m and one between them with a door from 1.5 to 2.4: 24 + 4 - 0.9 m of lines."""
    scene = two_rooms(table(0.2, 0.5))
    plan = make_floorplan(scene, make_grid(scene, 1.0))
    walls = plan.walls[0]
    assert np.hypot(walls[:, 2] - walls[:, 0], walls[:, 3] - walls[:, 1]).sum() == pytest.approx(
        27.1, abs=0.01
    )
    inner = walls[np.isclose(walls[:, [0, 2]], 4.0).all(axis=1)]
    assert not (
        (np.minimum(inner[:, 1], inner[:, 3]) < 2.3) & (np.maximum(inner[:, 1], inner[:, 3]) > 1.6)
    ).any()
    (tmp_path / "floorplan.hdf5").write_bytes(encode_floorplan(plan))
    again = read_floorplan(tmp_path)
    np.testing.assert_array_equal(again.walls[0], walls)
    np.testing.assert_array_equal(again.furniture, plan.furniture)
    with pytest.raises(ss.DatasetError, match="cannot open this floor plan"):
        read_floorplan(tmp_path / "nowhere")


def test_nothing_is_interpolated_through_a_wall() -> None:
    scene = two_rooms(table(0.2, 0.5), door=False)
    grid = make_grid(scene, 1.0)
    plan = make_floorplan(scene, grid)
    image, (x0, x1, _, _) = interpolate(
        plan, 0, grid.points, np.where(grid.points[:, 0] < 4, 10.0, -10.0), 1.5
    )
    x = x0 + (np.arange(image.shape[1]) + 0.5) * (x1 - x0) / image.shape[1]
    left, right = image[:, (x > 0.2) & (x < 3.8)], image[:, (x > 4.2) & (x < 7.8)]
    assert np.nanmax(np.abs(left - 10.0)) < 1e-9 and np.nanmax(np.abs(right + 10.0)) < 1e-9


def test_the_field_is_lower_behind_a_closed_wall_than_through_a_door() -> None:
    levels = {}
    for door in (True, False):
        scene = two_rooms(table([0.3, 0.3], [0.5, 0.5], [0.0, 0.001]), 1, door=door)
        grid = make_grid(scene, 1.0)
        source = grid.points[[0]]
        echoes = ss.simulate(scene, source, grid.points, plain(walks=128, duration=0.3))
        levels[door] = levels_of([echoes[0, i] for i in range(len(grid.points))])
        plan = make_floorplan(scene, grid)
        image, (x0, x1, _, _) = interpolate(plan, 0, grid.points, levels[door], 1.5)
        x = x0 + (np.arange(image.shape[1]) + 0.5) * (x1 - x0) / image.shape[1]
        levels[door] = np.nanmean(image[:, x > 4.3]) - np.nanmean(image[:, (x > 1.5) & (x < 3.7)])
    assert levels[False] < levels[True] - 10.0 < 0.0


@pytest.mark.parametrize("azimuth_deg", [0.0, 75.0, 200.0])
def test_a_lobe_points_at_the_source(azimuth_deg: float) -> None:
    direction = np.array([np.cos(np.deg2rad(azimuth_deg)), np.sin(np.deg2rad(azimuth_deg)), 0.0])
    none = Arrivals(np.empty(0), np.empty((0, 4)), np.empty((0, 3)), np.empty((0, 2), int))
    echogram = ss.Echogram(
        (0.0, 176.0, 775.0, 3409.0, 20000.0), np.arange(11) * 1e-3, np.zeros((10, 9, 4), np.float32),
        Arrival(0.005, np.ones(4), direction), none, np.zeros((2, 4)), True,
    )  # fmt: skip
    angles = np.deg2rad(np.arange(360.0))
    pattern = lobe(moments(echogram, direct_only=True), angles)
    assert abs(np.rad2deg(angles[pattern.argmax()]) - azimuth_deg) < 1.0
    # max-rE weights: (1 - 3 g1 + 5 g2) / (1 + 3 g1 + 5 g2) behind
    assert pattern[int(azimuth_deg + 180) % 360] == pytest.approx(0.675 / 5.325, rel=0.01)
    scene = two_rooms(table(0.2, 0.5))
    figure, ax = plt.subplots()
    draw_lobes(
        ax,
        make_floorplan(scene, make_grid(scene, 1.0)),
        np.zeros(3),
        np.array([[2.0, 2.0, 1.5]]),
        [echogram],
    )
    corners = np.concatenate([patch.get_path().vertices for patch in ax.patches])
    assert np.allclose(
        corners[np.linalg.norm(corners - [2.0, 2.0], axis=1).argmax()], [2, 2] + direction[:2], atol=0.02
    )
    plt.close(figure)


@pytest.mark.parametrize("what", ["map", "field", "lobes", "decay", "rir", "error"])
def test_every_page_can_be_drawn(dataset_folder: Path, tmp_path: Path, what: str) -> None:
    figure = draw_page(load_plot_data(dataset_folder), what)
    figure.savefig(tmp_path / "page.png")
    assert all(ax.get_xlabel() or ax.get_ylabel() for ax in figure.axes)
    labels = " ".join(ax.get_xlabel() + ax.get_ylabel() for ax in figure.axes)
    assert "(m)" in labels or "(s)" in labels
    plt.close(figure)


@pytest.mark.parametrize("what", ["map", "field", "lobes", "error"])
@pytest.mark.parametrize("odd", ["far away", "without end", "no walls", "one storey for three"])
def test_plans_that_do_not_fit_their_points(
    dataset_folder: Path, tmp_path: Path, what: str, odd: str
) -> None:
    """A dataset's plan may come from anybody: what it draws is odd, but it is drawn."""
    data = load_plot_data(dataset_folder)
    plan, points = data.plan, data.points.copy()
    if odd == "far away":
        plan = replace(plan, walls=tuple(w + 1e7 for w in plan.walls))
    elif odd == "without end":
        plan = replace(plan, walls=tuple(w * 1e12 for w in plan.walls), cell=999.0)
    elif odd == "no walls":
        plan = replace(plan, walls=tuple(np.empty((0, 4)) for _ in plan.walls))
    else:
        points[:, 2] += 3.0 * (np.arange(len(points)) % 3)
        assert len(plan.walls) == 1
    figure = draw_page(replace(data, plan=plan, points=points), what)
    figure.savefig(tmp_path / "page.png")
    plt.close(figure)


def test_walls_stop_sight_wherever_they_begin() -> None:
    """A wall that begins and ends far outside of the picture is as one that ends at its border."""
    points = np.array([[1.0, 1.0, 1.5], [3.0, 1.0, 1.5]])
    values = np.array([0.0, 10.0])
    furniture = np.full((1, 1, 1), -1)
    near, far = (
        interpolate(
            FloorPlan((np.array([[2.0, -y, 2.0, y]]),), furniture, ("",), np.zeros(2)),
            0,
            points,
            values,
            3.0,
        )[0]
        for y in (8.0, 1e9)
    )
    np.testing.assert_array_equal(near, far)
    values_seen = near[np.isfinite(near)]
    assert (
        np.minimum(np.abs(values_seen), np.abs(values_seen - 10.0)).max() < 1e-9
    )  # none mixed across it
    assert values_seen.min() < 1.0 and values_seen.max() > 9.0


@pytest.mark.parametrize("what", ["field", "error"])
def test_maps_of_one_quantity_get_steadily_brighter(dataset_folder: Path, what: str) -> None:
    """A level has no middle: its colours are a sequence in luminance (Rec. 709), not two diverging ones."""
    figure = draw_page(load_plot_data(dataset_folder), what)
    (image,) = figure.axes[0].images
    luminance = image.cmap(np.linspace(0.0, 1.0, 64))[:, :3] @ [0.2126, 0.7152, 0.0722]
    assert np.all(np.diff(luminance) > 0.0)
    assert "point" not in figure.axes[0].get_title()  # nor a number that no reader knows
    plt.close(figure)


def test_lobes_have_a_scale(dataset_folder: Path) -> None:
    """Rings at the strongest direction and at half of its energy: 10 lg 0.5 = -3 dB."""
    figure = draw_page(load_plot_data(dataset_folder), "lobes")
    texts = [text.get_text() for text in figure.axes[0].texts]
    assert "0 dB" in texts and "−3 dB" in texts
    plt.close(figure)


def test_bad_pages(dataset_folder: Path) -> None:
    data = load_plot_data(dataset_folder)
    with pytest.raises(ss.ConfigError, match="map, field"):
        draw_page(data, "portrait")
    with pytest.raises(ss.ConfigError, match="out of range"):
        draw_page(data, "field", source=999)


def test_plot_command_on_a_scene(tmp_path: Path) -> None:
    how = ("--spacing", "2", "--out", "map.svg", "--print", "column")
    result = run_command("plot", "demo", *how, cwd=tmp_path)
    assert result.returncode == 0, result.stderr
    assert "Caption: demo: where sources and listeners stand" in result.stdout
    text = (tmp_path / "map.svg").read_text()
    assert text.startswith("<?xml") and len(text) > 10_000 and 'width="238.' in text  # pt: 8.4 cm


def test_dry_sounds() -> None:
    for sound in (dry.syllables(16000), dry.hand_clap(16000), dry.music(16000)):
        assert (
            sound.dtype == np.float32
            and np.isfinite(sound).all()
            and np.abs(sound).max() == pytest.approx(0.5)
        )
    clap = dry.hand_clap(44100)
    assert (clap[: 44100 // 50] ** 2).sum() > 0.95 * (clap**2).sum()


@ci_slow
def test_listening_folder(dataset_folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("soundspaces_pictures.listen._HEADINGS", (90.0,))  # of four
    with ss.open_dataset(dataset_folder) as ds:
        recording = tmp_path / "own.wav"
        soundfile.write(recording, np.random.default_rng(0).standard_normal(800) * 0.1, 8000)
        count = listening_folder(ds, tmp_path / "out", {"speech": recording, "music": recording})
    written = [len(list((tmp_path / "out").glob(kind))) for kind in ("*.wav", "*.png")]
    assert written == [count, count] == [18, 18]  # 3 sounds, 3 places, mono and one heading
    mono, rate = soundfile.read(tmp_path / "out" / "clap_near_mono.wav")
    ears, _ = soundfile.read(tmp_path / "out" / "clap_near_090.wav")
    assert rate == 16000 and mono.ndim == 1 and ears.shape[1] == 2
    with (
        pytest.raises(ss.ConfigError, match="cannot read this sound"),
        ss.open_dataset(dataset_folder) as ds,
    ):
        listening_folder(ds, tmp_path / "bad", {"speech": tmp_path / "missing.wav"})


@ci_slow
def test_json_log_lines(tmp_path: Path) -> None:
    (tmp_path / "quick.toml").write_text(
        "[grid]\nrays = 100\n[simulation]\nwalks = 16\nconnections.subpaths = 2\nduration = 0.1\nradiance_transfer = false\n"
        "diffraction = false\n[dataset]\ntile = 4\n"
    )
    command = [sys.executable, "-m", "soundspaces_sim.cli", "--log-json", "rirs", "demo", "--spacing", "3",
               "--config", "quick.toml"]  # fmt: skip
    result = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    assert result.returncode == 0, result.stderr
    lines = [json.loads(line) for line in result.stderr.splitlines()]
    events = [line for line in lines if "stage" in line]
    assert events[-1]["done"] == events[-1]["total"] and events[-1]["rirs"] > 0
    assert {"time", "level", "message", "rirs_per_s", "memory_mb"} <= set(events[-1])


def test_the_direct_sound_of_a_field_is_exact() -> None:
    """In the open the level at r is -20 lg r, wherever the points of the grid are, and 0 dB at 1 m; behind a wall
    nothing of it is left."""
    x, y = np.meshgrid(np.arange(-2.0, 2.1), np.arange(-2.0, 2.1))
    points = np.column_stack([x.ravel(), y.ravel(), np.full(x.size, 1.5)])
    source = points[12]
    away = np.linalg.norm(points - source, axis=1)
    assert away.min() == 0.0
    wall = np.array([[1.5, -9.0, 1.5, 9.0]])
    visible = points[:, 0] < 1.5
    none = Arrivals(np.empty(0), np.empty((0, 4)), np.empty((0, 3)), np.empty((0, 2), int))
    echoes = [
        ss.Echogram(
            (0.0, 176.0, 775.0, 3409.0, 20000.0), np.arange(3) * 1e-3, np.zeros((2, 9, 4), np.float32),
            Arrival(r / 343.0, np.full(4, 1.0 / (4.0 * np.pi * max(r, 0.05) ** 2)), np.zeros(3)) if seen else None,
            none, np.zeros((2, 4)), bool(seen),
        )
        for r, seen in zip(away, visible, strict=True)
    ]  # fmt: skip
    field = band_field(source, points, echoes)
    assert len(field.points) == 24 and field.band == "775 to 3409 Hz"
    np.testing.assert_allclose(field.direct, visible[away > 0.0], rtol=1e-12)
    plan = FloorPlan((wall,), np.full((1, 1, 1), -1), ("",), np.zeros(2))
    image, (x0, x1, y0, y1) = field_levels(plan, 0, field, 1.5)
    cx = x0 + (np.arange(image.shape[1]) + 0.5) * (x1 - x0) / image.shape[1]
    cy = y0 + (np.arange(image.shape[0]) + 0.5) * (y1 - y0) / image.shape[0]
    r = np.hypot(cx[None, :] - source[0], cy[:, None] - source[1])
    lit = np.broadcast_to(cx[None, :] < 1.4, r.shape) & (r > 0.1) & (r < 1.4)
    np.testing.assert_allclose(image[lit], -20.0 * np.log10(r[lit]), atol=1e-9)
    assert np.isnan(image[:, cx > 1.6]).all()


def test_a_field_names_its_band(dataset_folder: Path) -> None:
    figure = draw_page(load_plot_data(dataset_folder), "field")
    assert "775 to 3409 Hz (dB re the source's direct sound at 1 m)" in figure.axes[1].get_ylabel()
    plt.close(figure)
