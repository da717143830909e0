"""Maps of modes: the first mode of a long room is a cosine along it."""

from dataclasses import replace
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pytest
from soundspaces_pictures.pages import draw_page, strongest
from soundspaces_pictures.plot_data import PlotData, load_plot_data

import soundspaces_sim as ss
from soundspaces_sim.core.errors import ConfigError, DatasetError
from soundspaces_sim.layout.floor_plan import make_floorplan
from soundspaces_sim.layout.grid import make_grid

LENGTH = 5.0


@pytest.fixture(scope="module")
def data() -> PlotData:
    room = ss.shoebox((LENGTH, 2.0, 2.4), absorption=0.05, name="long")
    grid = make_grid(room, 0.5)
    plan = make_floorplan(room, grid)
    nodes, edges = np.arange(len(grid.points)), np.empty((0, 2), int)
    return PlotData("long", plan, grid, grid.points, nodes, edges, 0.5, None, room)


def test_the_strongest_mode_is_that_of_the_room_along_its_length(data: PlotData) -> None:
    source = int(data.points[:, 0].argmin())
    others = np.flatnonzero(np.arange(len(data.points)) != source)
    waves = data.waves(source, others)
    first = 343.0 / (2.0 * LENGTH)
    below = [w.at(np.array([first]))[0, 0] for w in waves]
    shape = np.cos(np.pi * data.points[others, 0] / LENGTH)
    fit = np.abs(np.vdot(shape, below)) / (np.linalg.norm(shape) * np.linalg.norm(below))
    assert fit > 0.98
    nearest = strongest(waves) / first
    assert nearest == pytest.approx(round(nearest), abs=0.02)
    whole, _ = waves[0].transfer()
    np.testing.assert_allclose(waves[0].at(whole), waves[0].transfer()[1])


def test_the_page_shows_the_frequency_that_is_asked_for(data: PlotData) -> None:
    asked = replace(data, frequency_hz=34.3)
    figure = draw_page(asked, "modes", int(data.points[:, 0].argmin()))
    assert "34.3 Hz" in figure.axes[0].get_title()
    image = np.asarray(figure.axes[0].images[0].get_array())
    shown = np.isfinite(image).any(axis=0)
    across = np.nanmean(image[:, shown], axis=0)
    assert across.max() - across[len(across) // 2] > 10.0  # a node in the middle
    plt.close(figure)
    with pytest.raises(ConfigError, match="frequency"):
        draw_page(replace(data, frequency_hz=400.0), "modes")


def test_a_dataset_without_waves_has_no_map_of_modes(dataset_folder: Path) -> None:
    with pytest.raises(DatasetError, match="holds no waves"):
        draw_page(load_plot_data(dataset_folder), "modes")
