"""Blocks of sound against whole responses."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import scipy.signal
from soundspaces_continuous.signals import SourceSignal
from soundspaces_continuous.sound_field import SoundField
from soundspaces_continuous.step_renderer import Sounding, StepRenderer, _packed, _unpacked

import soundspaces_sim.nav as nav
from neighbours.continuous.tests.twin import below
from soundspaces_sim.nav.cache import BlockCache
from tests.nav.conftest import LADDER, T_CORRIDOR, lattice_scene

SCENES = {"ladder": lattice_scene(LADDER, "ladder"), "tee": lattice_scene(T_CORRIDOR, "tee")}
BLOCK, FADE, RATE = 4000, 192, 16000


@pytest.fixture(scope="module", params=["ladder", "tee"])
def field(request: pytest.FixtureRequest, graphs: Any) -> SoundField:
    return SoundField(nav.NavData(graphs).dataset(request.param), SCENES[request.param])


def renderer(field: SoundField, fade: int = FADE) -> StepRenderer:
    return StepRenderer(field, BLOCK, fade, BlockCache(10**9))


def test_blocks_at_a_point_are_the_datasets_rendering(field: SoundField) -> None:
    """Any heading, at rest: all blocks together are the signal through the whole response, as datasets render it."""
    made, ds = renderer(field), field.ds
    signal = np.random.default_rng(3).standard_normal(20000).astype(np.float32)
    for s, l, heading in ((0, 3, 0.0), (4, 1, 37.3), (2, 6, 211.0)):
        tail, blocks = None, []
        source = Sounding(SourceSignal("noise", signal, 0, 20000), field.at_point(s))
        for j in range(6):
            block, tail = made.hear(j, [source], field.place(ds.points[l]), np.deg2rad(heading), tail)
            blocks.append(block)
        response = ds.rendered(
            field.echogram(field.at_point(s), field.place(ds.points[l])), s, l, heading
        )
        whole = np.stack([scipy.signal.fftconvolve(signal, ear) for ear in response])
        found = np.concatenate(blocks, axis=1)
        n = min(found.shape[1], whole.shape[1])
        error = below(found[:, :n] - whole[:, :n], 6000.0)
        assert np.abs(error).max() < 2e-3 * np.abs(whole).max()


def test_no_click_at_a_step(field: SoundField) -> None:
    """A low tone while the agent steps and turns: its second difference stays what a tone's is; without a cross-fade
    it jumps. Curvature of a tone of amplitude A: A (2 pi f / rate)²."""
    tone = np.sin(2.0 * np.pi * 100.0 * np.arange(RATE) / RATE).astype(np.float32)
    source = Sounding(SourceSignal("tone", tone, -RATE * 100, 10**9), field.at_point(0))

    def bend(fade: int) -> float:
        made, tail, blocks = renderer(field, fade), None, []
        for j in range(8):
            place = field.place(field.ds.points[1] + [0.0, -0.3 + 0.08 * j, 0.0])
            block, tail = made.hear(j, [source], place, 0.26 * j, tail)
            blocks.append(block)
        heard = np.concatenate(blocks[4:], axis=1).astype(float)
        curved = np.abs(np.diff(heard, 2, axis=1)).max()
        return float(curved / (np.abs(heard).max() * (2.0 * np.pi * 100.0 / RATE) ** 2))

    smooth, hard = bend(FADE), bend(1)
    assert smooth < 3.0 and hard > 5.0 * smooth


def test_a_source_on_its_way_is_heard_from_there(field: SoundField) -> None:
    """Delay and level of the direct sound of a source between two points: c and 1 / r."""
    made, place = renderer(field), field.place(field.ds.points[1])
    click = np.zeros(BLOCK, np.float32)
    click[0] = 1.0
    for share in (0.0, 0.25, 0.6, 1.0):
        source = field.between(2, 3, share)
        heard, _ = made.hear(
            0, [Sounding(SourceSignal(f"c{share}", click, 0, BLOCK), source)], place, 0.0
        )
        apart = float(np.linalg.norm(source.position - place.position))
        both = np.abs(scipy.signal.hilbert(below(heard, 6000.0))).sum(axis=0)
        assert abs(int(both[:2000].argmax()) - apart / 343.0 * RATE) < 12


def test_nothing_is_made_that_is_not_heard(field: SoundField, monkeypatch: pytest.MonkeyPatch) -> None:
    """Reverberation of each pair once, none before a sound begins; colours of those pairs whose paths arrive, none
    where paths are simulated."""
    made: list[tuple[str, int, int]] = []
    of_pair = StepRenderer._of_pair

    def counted(self: StepRenderer, what: str, s: int, l: int, make: Any) -> Any:
        def make_and_count(*given: Any) -> Any:
            made.append((what, s, l))
            return make(*given)

        return of_pair(self, what, s, l, make_and_count)

    monkeypatch.setattr(StepRenderer, "_of_pair", counted)
    clip = np.random.default_rng(1).standard_normal(RATE).astype(np.float32)
    for paths in ("simulated", "moved"):
        own = SoundField(field.ds, field.scene, paths=paths)
        source = own.at_point(0)
        place = own.place(own.points[1] + field.scene.center + [0.1, 0.2, 0.0])
        assert len(place.points) > 1
        sounding = [Sounding(SourceSignal("late", clip, 3 * BLOCK, 10**9), source)]
        steps = renderer(own)
        for step in range(2):
            assert not steps.hear(step, sounding, place, 0.0)[0].any()
        assert not made
        for step in range(2, 6):
            ears, _ = steps.hear(step, sounding, place, 0.3 * step)
        assert ears.any()
        heard, first = [], 0
        if paths == "moved":
            arriving = own.heard(source, place)
            for pair, end in zip(arriving.pairs, arriving.ends, strict=True):
                heard += [pair] if end > first else []
                first = end
            assert heard
        assert sorted(made) == sorted(
            [("late", 0, l) for l in place.points] + [("colour", *pair) for pair in heard]
        )
        made.clear()


def test_what_is_kept_is_within_2_to_the_minus_16_of_its_peak() -> None:
    """Noise that decays by 70 dB, one that is silent, one that ends within a stretch: 16 bits and then 8, each error
    below half a unit of its own scale, and that below 2^-16 of the response's peak."""
    rng = np.random.default_rng(5)
    fall = 10.0 ** (-3.5 * np.arange(8000) / 8000)
    samples = (rng.standard_normal((3, 1, 8000)) * fall).astype(np.float32)
    samples[1] = 0.0
    packed = _packed(samples)
    assert packed.fine.dtype == np.int16 and packed.coarse.dtype == np.int8
    assert 4000 < packed.fine.shape[2] < 7000 and packed.fine.shape[2] + packed.coarse.shape[2] == 8000
    found = np.empty((3, 8000), np.float32)
    _unpacked(packed, np.array([2, 0, 1]), found)
    error = np.abs(found - samples[[2, 0, 1], 0])
    peak = np.abs(samples[[2, 0], 0]).max(axis=1)
    assert (error[:2].max(axis=1) < 2.0**-16 * peak).all() and (error[2] == 0.0).all()
    beyond = packed.fine.shape[2]
    assert error[:2, :beyond].max() < 2.0**-16 * peak.max() and error[:2, beyond:].max() > 0.0
    short = rng.standard_normal((1, 10, 130)).astype(np.float32)  # all of it loud
    whole = _packed(short)
    assert whole.coarse.shape == (1, 10, 0) and whole.scale.shape == (1, 2)
