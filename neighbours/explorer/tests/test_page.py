"""The explorer's page in Chromium: what is heard, what a click does, and the copy that opens from disk.

Needs playwright and a Chromium (``CHROMIUM``, else one on the path); skips without.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from soundspaces_explorer.export import HEADINGS, export_explorer
from soundspaces_explorer.live import LiveScene
from soundspaces_explorer.server import ExplorerServer

import soundspaces_sim as ss
from neighbours.explorer.tests.live_page import DONE, ON_PLAN, REFLECTED, check_live_sound

sync_api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
CHROMIUM = os.environ.get("CHROMIUM") or shutil.which("chromium") or shutil.which("google-chrome")
pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="there is no Chromium on the path")
READY = "document.body.dataset.ready !== undefined"
#: Tables of which a part is hidden.
CUT_OFF = (
    "[...document.querySelectorAll('.wide')].filter((box) => box.scrollWidth > box.clientWidth)"
    ".map((box) => [box.firstChild.id, box.scrollWidth, box.clientWidth])"
)
#: What can be touched and is less than 24 px high or wide (WCAG 2.2, 2.5.8).
SMALL = (
    "[...document.querySelectorAll('button, select, input, summary')].map((box) => [box.id || box.ariaLabel, box.getBoundingClientRect()])"
    ".filter(([, { width, height }]) => width > 0 && Math.min(width, height) < 24).map(([name]) => name)"
)


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    with sync_api.sync_playwright() as play:
        launched = play.chromium.launch(
            executable_path=CHROMIUM, args=["--no-sandbox", "--autoplay-policy=no-user-gesture-required"]
        )
        yield launched
        launched.close()


@pytest.fixture
def page(browser: Any) -> Iterator[Any]:
    """A page that fails the test on any error of its scripts, and on anything it loads from elsewhere."""
    # Playwright's own functions are evaluated, which the page's policy forbids; see the last test
    opened = browser.new_page(viewport={"width": 1280, "height": 900}, bypass_csp=True)
    problems: list[str] = []
    opened.on("pageerror", lambda error: problems.append(str(error)))
    opened.on("console", lambda m: problems.append(m.text) if m.type == "error" else None)
    opened.on(
        "request",
        lambda r: (
            problems.append(r.url)
            if not r.url.startswith(("http://127.0.0.1", "file:", "data:", "blob:"))
            else None
        ),
    )
    yield opened
    opened.close()
    assert problems == []


def test_it_sounds_as_the_reader_says(page: Any, url: str, dataset_folder: Path) -> None:
    """Noise through the page's audio graph is the noise through the reader's response, to 1e-4 of its peak."""
    page.goto(url)
    page.wait_for_function(READY)
    noise = np.random.default_rng(0).standard_normal(2000).astype(np.float32)
    heard = np.array(
        page.evaluate("([x, s, l, h]) => explorerRender(x, s, l, h)", [noise.tolist(), 1, 3, 40.0])
    )
    with ss.open_dataset(dataset_folder, 16000) as ds:
        wanted = ds.render(noise, 1, 3, heading_deg=40.0)
    n = min(heard.shape[1], wanted.shape[1])
    np.testing.assert_allclose(heard[:, :n], wanted[:, :n], atol=1e-4 * np.abs(wanted).max())


def test_clicks_and_keys_move_the_ends(page: Any, url: str, dataset_folder: Path) -> None:
    page.goto(url)
    page.wait_for_function(READY)
    with ss.open_dataset(dataset_folder) as ds:
        points = ds.points
    at = page.evaluate(
        "() => { const b = document.getElementById('plan'); const v = view(b.clientWidth, b.clientHeight);"
        " const r = b.getBoundingClientRect(); return state.data.points.map((p) => { const q = v.at(p);"
        " return [q[0] + r.left, q[1] + r.top]; }); }"
    )
    page.mouse.click(*at[2])
    page.wait_for_function("document.body.dataset.pair.endsWith(',2')")
    page.keyboard.down("Shift")
    page.mouse.click(*at[4])
    page.keyboard.up("Shift")
    page.wait_for_function("document.body.dataset.pair === '4,2'")
    text = page.inner_text("#pair")
    assert f"{np.linalg.norm(points[4] - points[2]):.2f} m" in text
    east = [i for i in range(len(points)) if points[i][0] > points[2][0] + 1e-6]
    if east:
        page.focus("#plan")
        page.keyboard.press("ArrowRight")
        page.wait_for_function("!document.body.dataset.pair.endsWith(',2')")
        assert int(page.evaluate("document.body.dataset.pair.split(',')[1]")) in east
    page.keyboard.press(",")
    assert page.evaluate("state.heading") == 10
    assert page.locator("#measures tr").count() == 9


def test_fingers_move_the_source_too(browser: Any, url: str) -> None:
    """A phone has neither Shift nor a right button; its page is no wider than it is."""
    context = browser.new_context(
        viewport={"width": 390, "height": 844}, has_touch=True, is_mobile=True, bypass_csp=True
    )
    page = context.new_page()
    page.goto(url)
    page.wait_for_function(READY)
    assert page.evaluate("document.documentElement.scrollWidth") <= 390
    assert page.evaluate(CUT_OFF) == [] and page.evaluate(SMALL) == []
    page.select_option("#moves", "source")
    listener = page.evaluate("state.listener")
    for point in (4, listener):  # where the listener is as well
        at = page.evaluate(
            "(i) => { const b = document.getElementById('plan'), r = b.getBoundingClientRect();"
            " const q = view(b.clientWidth, b.clientHeight).at(state.data.points[i]);"
            " return [q[0] + r.left, q[1] + r.top]; }",
            point,
        )
        page.touchscreen.tap(*at)
        page.wait_for_function(f"document.body.dataset.pair === '{point},{listener}'")
    context.close()


def test_axes_name_their_units(page: Any, url: str) -> None:
    """What is written on the canvases."""
    page.add_init_script(
        "window.written = []; const write = CanvasRenderingContext2D.prototype.fillText;"
        "CanvasRenderingContext2D.prototype.fillText = function (text, ...at) {"
        " window.written.push(text); return write.call(this, text, ...at); };"
    )
    page.goto(url)
    page.wait_for_function(READY)
    written = page.evaluate("window.written")
    for text in ("x (m)", "y (m)", "dB", "time since emission (s)", "decay (dB re all energy)"):
        assert text in written
    assert any(
        w.endswith(" m") and w[:-2].replace(".", "").isdecimal() for w in written
    )  # the scale bar
    assert not any(w in ("-0", "−0", "−0.0", "NaN", "-Infinity") for w in written)


def test_it_plays_and_stops(page: Any, url: str) -> None:
    page.goto(url)
    page.wait_for_function(READY)
    page.click("#play")
    page.wait_for_function("audio.playing !== null && audio.context.currentTime > 0.1")
    assert page.get_attribute("#play", "aria-pressed") == "true"
    page.focus("#plan")
    page.keyboard.press("ArrowLeft")
    page.keyboard.press("ArrowRight")  # cross-fades while it plays
    page.wait_for_timeout(400)
    page.click("#play")
    assert page.evaluate("audio.playing") is None and page.inner_text("#status") == ""


def test_the_copy_opens_from_disk(page: Any, dataset_folder: Path, tmp_path: Path) -> None:
    """Its responses are the reader's to the rounding of 16 bits, at the exported headings."""
    with ss.open_dataset(dataset_folder, 16000) as ds:
        size = export_explorer(ds, tmp_path / "copy", 4)
        page.goto((tmp_path / "copy" / "index.html").as_uri())
        page.wait_for_function(READY)
        chosen = page.evaluate("state.data.chosen")
        assert len(chosen) == 4
        assert size == sum(f.stat().st_size for f in (tmp_path / "copy").iterdir())
        s, l = chosen[0], chosen[2]
        ears = np.array(
            page.evaluate(
                "async ([s, l, h]) => (await data.response(state.name, s, l, h)).map((x) => Array.from(x))",
                [s, l, HEADINGS[1]],
            )
        )
        wanted = ds.binaural(s, l, HEADINGS[1])
        np.testing.assert_allclose(ears, wanted, atol=1.1 / 32767 * np.abs(ears).max() * 4)
        page.click("#play")
        page.wait_for_function("audio.playing !== null")


def test_pages_keep_to_their_own_policy(browser: Any, url: str, live_server: ExplorerServer) -> None:
    """With the policy in force nothing is refused."""
    for address in (url, live_server.url):
        page = browser.new_page()
        problems: list[str] = []
        page.on("console", lambda m, found=problems: found.append(m.text) if m.type == "error" else None)
        page.goto(address)
        page.wait_for_selector("body[data-ready]")
        page.close()
        assert problems == []


# ---- a live scene ----


def test_a_live_scene_sounds_as_it_is_simulated(
    page: Any, live_server: ExplorerServer, live_scene: LiveScene
) -> None:
    page.goto(live_server.url)
    page.wait_for_function(READY)
    page.wait_for_function(DONE)
    check_live_sound(page.evaluate, live_scene)


def test_a_click_is_heard_and_keys_walk(page: Any, live_server: ExplorerServer) -> None:
    page.goto(live_server.url)
    page.wait_for_function(READY)
    page.mouse.click(*page.evaluate(f"({ON_PLAN})([4.5, 1.5])"))
    page.wait_for_function("audio.playing !== null && document.body.dataset.heard !== undefined")
    assert page.evaluate("state.listener.slice(0, 2)") == pytest.approx([4.5, 1.5], abs=0.05)
    page.wait_for_function(DONE)
    heard, source = page.evaluate("[Number(document.body.dataset.heard), state.source]")
    page.keyboard.press("ArrowLeft")
    page.wait_for_function(f"Number(document.body.dataset.heard) > {heard}")
    assert page.evaluate("state.listener[0]") == pytest.approx(4.25, abs=0.05)
    page.keyboard.press("Shift+ArrowUp")
    assert page.evaluate("state.source[1]") == pytest.approx(source[1] + 0.25)
    heading = page.evaluate("state.heading")
    page.keyboard.press(",")
    assert page.evaluate("state.heading") == heading + 5
    page.keyboard.press(" ")
    assert page.evaluate("audio.playing") is None


def test_a_mark_is_dragged(page: Any, live_server: ExplorerServer) -> None:
    page.goto(live_server.url)
    page.wait_for_function(READY)
    page.mouse.move(*page.evaluate(f"({ON_PLAN})(state.source)"))
    page.mouse.down()
    page.mouse.move(*page.evaluate(f"({ON_PLAN})([2.0, 4.0])"), steps=4)
    page.mouse.up()
    assert page.evaluate("state.source.slice(0, 2)") == pytest.approx([2.0, 4.0], abs=0.05)
    page.wait_for_function(DONE)


def test_a_slider_is_heard_and_two_states_are_kept(page: Any, live_server: ExplorerServer) -> None:
    page.goto(live_server.url)
    page.wait_for_function(READY)
    page.wait_for_function(DONE)
    before = page.evaluate("state.answer.measures.c50.map((v) => v[0])")
    page.keyboard.press("b")
    page.evaluate(REFLECTED)
    page.wait_for_function("state.answer.kind === 'counts' || state.answer.step > 0")
    page.wait_for_function("Object.keys(state.chosen).length === 1")
    page.wait_for_function(DONE)
    after = page.evaluate("state.answer.measures.c50.map((v) => v[0])")
    assert all(a > b + 1.0 for a, b in zip(after, before, strict=True))
    page.keyboard.press("a")
    page.wait_for_function(DONE)
    assert page.evaluate("state.answer.measures.c50.map((v) => v[0])") == before
    assert page.evaluate("Object.keys(state.chosen)") == []


def test_an_own_sound_is_dropped(page: Any, live_server: ExplorerServer) -> None:
    page.goto(live_server.url)
    page.wait_for_function(READY)
    page.evaluate(
        "() => { const rate = 8000, n = 4000, data = new DataView(new ArrayBuffer(44 + 2 * n));"
        " const text = (at, s) => [...s].forEach((c, i) => data.setUint8(at + i, c.charCodeAt(0)));"
        " text(0, 'RIFF'); data.setUint32(4, 36 + 2 * n, true); text(8, 'WAVEfmt '); data.setUint32(16, 16, true);"
        " data.setUint16(20, 1, true); data.setUint16(22, 1, true); data.setUint32(24, rate, true);"
        " data.setUint32(28, 2 * rate, true); data.setUint16(32, 2, true); data.setUint16(34, 16, true);"
        " text(36, 'data'); data.setUint32(40, 2 * n, true); data.setInt16(44 + 2 * 100, 20000, true);"
        " const moved = new DataTransfer(); moved.items.add(new File([data], 'own.wav', { type: 'audio/wav' }));"
        " document.dispatchEvent(new DragEvent('drop', { dataTransfer: moved, bubbles: true, cancelable: true })); }"
    )
    page.wait_for_function(
        "audio.playing !== null && document.getElementById('sound').value === 'own file'"
    )
    assert page.evaluate("audio.playing.buffer.duration") == pytest.approx(0.5, abs=0.001)


def test_a_live_scene_on_a_phone(browser: Any, live_server: ExplorerServer) -> None:
    context = browser.new_context(
        viewport={"width": 390, "height": 844}, has_touch=True, is_mobile=True, bypass_csp=True
    )
    page = context.new_page()
    page.goto(live_server.url)
    page.wait_for_function(READY)
    page.wait_for_function(DONE)
    assert page.evaluate("document.documentElement.scrollWidth") <= 390
    assert page.evaluate(CUT_OFF) == [] and page.evaluate(SMALL) == []
    page.check("#place-source")
    page.touchscreen.tap(*page.evaluate(f"({ON_PLAN})([1.5, 4.0])"))
    page.wait_for_function("Math.hypot(state.source[0] - 1.5, state.source[1] - 4.0) < 0.1")
    page.wait_for_function("audio.playing !== null")
    context.close()


def test_a_live_scene_names_its_units(page: Any, live_server: ExplorerServer) -> None:
    page.add_init_script(
        "window.written = []; const write = CanvasRenderingContext2D.prototype.fillText;"
        "CanvasRenderingContext2D.prototype.fillText = function (text, ...at) {"
        " window.written.push(text); return write.call(this, text, ...at); };"
    )
    page.goto(live_server.url)
    page.wait_for_function(READY)
    page.wait_for_function(DONE)
    written = page.evaluate("window.written")
    for text in ("x (m)", "y (m)", "z (m)", "T30 (s)", "C50 (dB)", "0 dBFS"):
        assert text in written, text
    assert any(w.endswith(" m") and w[:-2].replace(".", "").isdecimal() for w in written)
    assert not any(w in ("-0", "−0", "NaN", "-Infinity") for w in written)


def test_a_live_scene_shows_what_stands_in_it(page: Any, live_server: ExplorerServer) -> None:
    """The floor in the pale colour of its material, what was guessed in words, and no table cut off."""
    page.goto(live_server.url)
    page.wait_for_function(READY)
    page.wait_for_function("state.floors[0] !== undefined")
    assert page.evaluate("state.floors[0].size") == pytest.approx([6.0, 5.0], abs=0.05)
    shown = page.evaluate(
        "(() => { const floor = state.floors[0].picture, k = state.scene.materials.find((m) => m.name === 'carpet').row;"
        " const pen = document.createElement('canvas').getContext('2d'); pen.fillStyle = colourOf(k);"
        " return [[...floor.getContext('2d').getImageData(floor.width / 2, floor.height / 2, 1, 1).data], pen.fillStyle]; })()"
    )
    strong = [int(shown[1][k : k + 2], 16) for k in (1, 3, 5)]
    np.testing.assert_allclose(shown[0], [*(255 - 0.16 * (255 - np.array(strong))), 255], atol=1.0)
    page.wait_for_function(DONE)
    assert page.evaluate(CUT_OFF) == []
    page.click("summary")
    assert "carpet: 30 m²" in page.inner_text("#notes")
    assert page.inner_text("#volume-text") == "0 dB"


def test_numbers_have_the_digits_that_their_errors_allow(page: Any, live_server: ExplorerServer) -> None:
    page.goto(live_server.url)
    page.wait_for_function(READY)
    for value, error, text in (
        (0.7123, 0.02, "0.71 ± 0.04"),
        (0.7123, 0.001, "0.712 ± 0.002"),
        (-0.7123, 0.4, "−0.7 ± 0.8"),
        (0.7123, None, "0.712 ± ?"),
        (None, None, "–"),
    ):
        assert page.evaluate("(given) => withError(given, 3)", [value, error]) == text


def test_a_dataset_is_written_on_demand(page: Any, live_server: ExplorerServer) -> None:
    page.goto(live_server.url)
    page.wait_for_function(READY)
    page.fill("#spacing", "2")
    page.click("#make")
    page.wait_for_selector("#job pre")
    assert page.inner_text("#job pre").startswith("soundspaces-sim rirs shoebox.obj --config ")
