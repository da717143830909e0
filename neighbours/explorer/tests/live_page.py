"""What tests of a live scene's page in Chromium and in Firefox have in common."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from soundspaces_explorer.live import LiveScene, Question

from neighbours.explorer.tests.conftest import RATE

DONE = "document.body.dataset.done !== undefined"
#: A function from a place on the plan, m, to the pixel of the window.
ON_PLAN = (
    "(p) => { const b = document.getElementById('plan'), r = b.getBoundingClientRect();"
    " const q = planView(b.clientWidth, b.clientHeight).at(p); return [q[0] + r.left, q[1] + r.top]; }"
)
#: The slider of the gypsum board goes up.
REFLECTED = (
    "(() => { const k = state.scene.materials.findIndex((m) => m.name === 'gypsum-board');"
    " const slider = document.querySelectorAll('#materials input')[k]; slider.value = 0.6;"
    " slider.dispatchEvent(new Event('input')); return true; })()"
)


def check_live_sound(evaluate: Callable[[str], Any], live: LiveScene) -> None:
    """Noise through the page's audio graph is the noise through the scene's response, to 1e-4 of its peak."""
    noise = np.random.default_rng(0).standard_normal(2000).astype(np.float32)
    heard = np.array(evaluate(f"liveRender({noise.tolist()})"))
    source, listener, heading = evaluate("[state.source, state.listener, state.heading]")
    there, here = (live.place(p[0], p[1], int(p[2])) for p in (source, listener))
    question = Question(there, here)
    response = live.ears(live.ask(question), float(heading), RATE)
    wanted = np.array([np.convolve(noise, ear) for ear in response])
    n = min(heard.shape[1], wanted.shape[1])
    assert n > 2000
    np.testing.assert_allclose(heard[:, :n], wanted[:, :n], atol=1e-4 * np.abs(wanted).max())
