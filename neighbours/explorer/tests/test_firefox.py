"""The explorer's page in Firefox: what is heard, what clicks and keys do.

Needs a Firefox (``FIREFOX``, else one on the path) and websockets; skips without.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from soundspaces_explorer.export import export_explorer
from soundspaces_explorer.live import LiveScene
from soundspaces_explorer.server import ExplorerServer

import soundspaces_sim as ss

pytest.importorskip("websockets.sync.client", reason="websockets is not installed")
from neighbours.explorer.tests.bidi import FIREFOX, Firefox, firefox
from neighbours.explorer.tests.live_page import DONE, ON_PLAN, REFLECTED, check_live_sound

pytestmark = pytest.mark.skipif(FIREFOX is None, reason="there is no Firefox on the path")
READY = "document.body.dataset.ready !== undefined"


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Firefox]:
    with firefox(tmp_path_factory.mktemp("firefox") / "profile") as opened:
        yield opened


@pytest.fixture
def page(browser: Firefox) -> Iterator[Firefox]:
    """A page that fails the test on any error of its scripts, and on anything it loads from elsewhere."""
    browser.problems.clear()
    yield browser
    browser.open("about:blank")
    assert browser.problems == []


def test_it_sounds_as_the_reader_says(page: Firefox, url: str, dataset_folder: Path) -> None:
    """Noise through the page's audio graph is the noise through the reader's response, to 1e-4 of its peak."""
    page.open(url)
    page.wait_for(READY)
    noise = np.random.default_rng(0).standard_normal(2000).astype(np.float32)
    heard = np.array(page.evaluate(f"explorerRender({noise.tolist()}, 1, 3, 40.0)"))
    with ss.open_dataset(dataset_folder, 16000) as ds:
        wanted = ds.render(noise, 1, 3, heading_deg=40.0)
    n = min(heard.shape[1], wanted.shape[1])
    assert n > 2000
    np.testing.assert_allclose(heard[:, :n], wanted[:, :n], atol=1e-4 * np.abs(wanted).max())


def test_clicks_and_keys_move_the_ends(page: Firefox, url: str) -> None:
    page.open(url)
    page.wait_for(READY)
    page.click_on("plan", "view(box.clientWidth, box.clientHeight).at(state.data.points[2])")
    page.wait_for("document.body.dataset.pair.endsWith(',2')")
    before = page.evaluate("state.heading")
    page.press(",")
    page.wait_for(f"state.heading === {before + 10}")


def test_it_plays_and_stops_or_says_that_it_cannot(page: Firefox, url: str) -> None:
    """Firefox needs a device for sound, which machines that test may not have: then the page says so."""
    page.open(url)
    page.wait_for(READY)
    status = "document.getElementById('status').textContent"
    page.click_on("play")
    page.wait_for(f"audio.playing !== null || {status}.includes('no device')")
    running = page.evaluate("audio.context.state") == "running"
    assert page.evaluate("audio.playing !== null") == running
    if running:
        page.click_on("play")
        page.wait_for(f"audio.playing === null && {status} === ''")


def test_the_copy_opens_from_disk(page: Firefox, dataset_folder: Path, tmp_path: Path) -> None:
    with ss.open_dataset(dataset_folder, 16000) as ds:
        export_explorer(ds, tmp_path / "copy", 4)
    page.open((tmp_path / "copy" / "index.html").as_uri())
    page.wait_for(READY)
    assert len(page.evaluate("state.data.chosen")) == 4


def test_a_live_scene_sounds_as_it_is_simulated(
    page: Firefox, live_server: ExplorerServer, live_scene: LiveScene
) -> None:
    page.open(live_server.url)
    page.wait_for(READY)
    page.wait_for(DONE)
    check_live_sound(page.evaluate, live_scene)


def test_a_live_scene_is_clicked_and_changed(page: Firefox, live_server: ExplorerServer) -> None:
    page.open(live_server.url)
    page.wait_for(READY)
    page.click(*page.evaluate(f"({ON_PLAN})([4.5, 1.5])"))
    page.wait_for("Math.hypot(state.listener[0] - 4.5, state.listener[1] - 1.5) < 0.1")
    page.wait_for(
        "audio.playing !== null || document.getElementById('problem').textContent.includes('no device')"
    )
    page.wait_for(DONE)
    before = page.evaluate("state.answer.measures.c50[1][0]")
    page.evaluate(REFLECTED)
    page.wait_for(
        f"{DONE} && state.answer.kind === 'estimate' && Object.keys(state.chosen).length === 1"
    )
    assert page.evaluate("state.answer.measures.c50[1][0]") > before + 1.0
