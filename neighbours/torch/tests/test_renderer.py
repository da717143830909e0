"""`ss.torch.Renderer` on the processor: what the NumPy reader makes, option by option; gradients against differences
of what the reader makes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.signal import fftconvolve
from soundspaces_rooms.room_stream import _until

import soundspaces_sim as ss
from soundspaces_sim.core.config import DatasetConfig
from soundspaces_sim.core.numerics.rng import combine
from soundspaces_sim.rendering.ambisonics import pair_seed
from soundspaces_sim.rendering.renderers import RENDERERS
from tests.conftest import small_job
from tests.rooms import box, plain

torch = pytest.importorskip("torch", reason="the extra 'torch' is not installed")

from soundspaces_torch import (  # noqa: E402
    echograms as torch_echograms,
    renderer as torch_renderer,
    signals as torch_signals,
)

import soundspaces_sim.torch  # noqa: E402

PAIRS = np.array([(0, 3), (1, 1), (2, 6), (7, 0), (5, 4)])
HEADS = np.array([(0.0, 0, 0), (30, 10, 0), (-90, 0, 20), (200, -5, 3), (75, 0, 0)])
SIZE = (3.2, 2.9, 2.4)
POINTS = np.random.default_rng(1).uniform(0.1, 0.9, (8, 3)) * SIZE
CLOSE = 1e-4  # of a response's peak; a few 1e-7 are found
ARRAY = ss.MicrophoneArray(
    [[0.1, 0.1, 0], [0.1, -0.1, 0], [0, 0, 0.05]], [ss.Cardioid(), None, None], heading_deg=40.0
)


def _close(made: Any, wanted: list[np.ndarray], least: float = 0.0) -> None:
    """Responses are those of the reader within `CLOSE` of their peaks, and zero behind their ends."""
    found = made.detach().numpy()
    assert found.dtype == np.float32 and len(found) == len(wanted)
    assert found.shape[2] == max(w.shape[1] for w in wanted)
    for response, want in zip(found, wanted, strict=True):
        peak = np.abs(want).max()
        assert peak > least
        assert np.abs(response[:, : want.shape[1]] - want).max() <= CLOSE * peak
        assert (response[:, want.shape[1] :] == 0.0).all()


@pytest.fixture(scope="module")
def counted(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A dataset whose three materials change on reading."""
    names = ("carpet", "gypsum-board", "acoustic-tile")
    absorption = np.repeat(np.array([[0.2], [0.08], [0.5]]), 2, axis=1)
    none = np.zeros((3, 2))
    materials = ss.MaterialTable(names, np.array([250.0, 2000.0]), absorption, none + 0.6, none)
    room = box(SIZE, materials, [1, 1, 1, 1, 0, 2])
    job = ss.JobConfig(
        simulation=plain(walks=64, duration=0.3, materials=True), dataset=DatasetConfig(rate=16000)
    )
    return ss.build_dataset(room, tmp_path_factory.mktemp("counted"), job, points=POINTS).folder


@pytest.fixture(scope="module")
def with_waves(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A dataset with waves below an edge."""
    low = ss.LowConfig(method="waves", cells_per_wavelength=8.0)
    job = ss.JobConfig(
        simulation=ss.SimulationConfig(walks=32, duration=0.2, low=low),
        dataset=DatasetConfig(rate=16000),
    )
    room = ss.shoebox(SIZE, absorption=0.3, scattering=0.2)
    return ss.build_dataset(room, tmp_path_factory.mktemp("waves"), job, points=POINTS).folder


OPTIONS: dict[str, tuple[dict[str, Any], Callable[[Any], Any], Callable[[Any, int, int, int], Any]]] = {
    "ambisonic": ({}, lambda r: r.ambisonic(PAIRS), lambda d, s, l, _: d.ambisonic(s, l)),
    "44.1 kHz": ({}, lambda r: r.ambisonic(PAIRS, 44100), lambda d, s, l, _: d.ambisonic(s, l, 44100)),
    "8 kHz": ({"rate": 8000}, lambda r: r.ambisonic(PAIRS), lambda d, s, l, _: d.ambisonic(s, l)),
    "talker": (
        {}, lambda r: r.ambisonic(PAIRS, source="talker"),
        lambda d, s, l, _: d.ambisonic(s, l, source="talker"),
    ),
    "talkers": (
        {},
        lambda r: r.binaural(PAIRS, source=[ss.Talker(heading_deg=30.0 * k) for k in range(5)]),
        lambda d, s, l, k: d.binaural(s, l, source=ss.Talker(heading_deg=30.0 * k)),
    ),
    "order 4": ({}, lambda r: r.ambisonic(PAIRS, order=4), lambda d, s, l, _: d.ambisonic(s, l, order=4)),
    "monaural": ({}, lambda r: r.monaural(PAIRS), lambda d, s, l, _: d.monaural(s, l)),
    "cardioid": (
        {}, lambda r: r.monaural(PAIRS, listener=ss.Cardioid()),
        lambda d, s, l, _: d.monaural(s, l, listener=ss.Cardioid()),
    ),
    "array": ({}, lambda r: r.microphones(PAIRS, ARRAY), lambda d, s, l, _: d.microphones(s, l, ARRAY)),
    "headings": (
        {}, lambda r: r.binaural(PAIRS, HEADS[:, 0]), lambda d, s, l, k: d.binaural(s, l, HEADS[k, 0]),
    ),
    "heads": (
        {}, lambda r: r.binaural(PAIRS, HEADS),
        lambda d, s, l, k: d.binaurals(s, l, HEADS[k : k + 1])[0],
    ),
    "ears, near": (
        {"hrtf": ss.Ears()}, lambda r: r.binaural(PAIRS, 10.0), lambda d, s, l, _: d.binaural(s, l, 10.0),
    ),
    "ears, moved": (
        {"hrtf": ss.Ears(offset=(0.1, 0.05, 0.0), decoder="magls", equalisation="none")},
        lambda r: r.binaural(PAIRS, HEADS[:, 0]), lambda d, s, l, k: d.binaural(s, l, HEADS[k, 0]),
    ),
    **{
        name: (
            {"renderer": name}, lambda r: r.ambisonic(PAIRS), lambda d, s, l, _: d.ambisonic(s, l),
        )
        for name in ("smooth", "paper", "direct")
    },
}  # fmt: skip


@pytest.mark.parametrize("option", OPTIONS)
@pytest.mark.parametrize("at_once", [2, 64])
def test_responses_are_the_readers(dataset_folder: Path, option: str, at_once: int) -> None:
    how, made, read = OPTIONS[option]
    with ss.open_dataset(dataset_folder, **how) as ds:
        wanted = [read(ds, int(s), int(l), k) for k, (s, l) in enumerate(PAIRS)]
        _close(made(ss.torch.Renderer(ds, at_once=at_once)), wanted)


def test_a_near_source_was_among_them(dataset_folder: Path) -> None:
    """Or the correction within a metre is compared with nothing."""
    with ss.open_dataset(dataset_folder, hrtf=ss.Ears()) as ds:
        ds.points[4] = ds.points[5] + [0.3, 0.2, 0.0]
        near = ds.echogram(5, 4)
        assert near.direct is not None
        moved = replace(
            near, direct=replace(near.direct, delay=0.36 / 343.0, direction=np.array([0.8, 0.6, 0.0]))
        )
        made = ss.torch.Renderer(ds).rendered([moved], [(5, 4)], 20.0)
        _close(made, [ds.rendered(moved, 5, 4, 20.0)])
        plain = ss.open_dataset(dataset_folder, hrtf=ss.Ears(near_field=False)).rendered(
            moved, 5, 4, 20.0
        )
        assert np.abs(made[0].numpy() - plain).max() > 0.01 * np.abs(plain).max()


def test_echograms_from_files_and_from_the_device_are_the_same(dataset_folder: Path) -> None:
    with ss.open_dataset(dataset_folder) as ds:
        kept, read = ss.torch.Renderer(ds), ss.torch.Renderer(ds, cache_mb=0.0)
        np.testing.assert_array_equal(kept.ambisonic(PAIRS), read.ambisonic(PAIRS))
        assert kept._kept is not None and read._kept is None
        s, l = PAIRS[2]
        of_device, ends = kept._kept.batch(PAIRS[2:3])
        of_file, end = torch_echograms.as_batch([ds.echogram(s, l)], torch.device("cpu"))
        for name, one, two in zip(of_device._fields, of_device, of_file, strict=True):
            np.testing.assert_array_equal(one, two, name)
        assert ends == pytest.approx(end, abs=1e-9)


def test_one_pair_and_pairs_of_other_lengths(dataset_folder: Path) -> None:
    """An arrival after the end of the time grid makes a response longer; others are padded."""
    with ss.open_dataset(dataset_folder) as ds:
        renderer = ss.torch.Renderer(ds)
        assert renderer.ambisonic((0, 3)).shape == (1, 9, 3200)
        late = ds.echogram(0, 3)
        late = replace(late, early=replace(late.early, delay=late.early.delay + 0.2))
        echograms = [ds.echogram(2, 6), late, ds.echogram(7, 0)]
        pairs = [(2, 6), (0, 3), (7, 0)]
        wanted = [ds.rendered(e, *p) for e, p in zip(echograms, pairs, strict=True)]
        assert len({w.shape[1] for w in wanted}) == 2
        _close(renderer.rendered(echograms, pairs), wanted)


def test_waves_below_an_edge(with_waves: Path) -> None:
    with ss.open_dataset(with_waves) as ds:
        assert ds.echogram(0, 3).low is not None
        renderer = ss.torch.Renderer(ds)
        _close(renderer.ambisonic(PAIRS), [ds.ambisonic(*p) for p in PAIRS])
        _close(renderer.microphones(PAIRS, ARRAY), [ds.microphones(s, l, ARRAY) for s, l in PAIRS])
        _close(
            renderer.ambisonic(PAIRS, source="talker"),
            [ds.ambisonic(*p, source="talker") for p in PAIRS],
        )
    with ss.open_dataset(with_waves, hrtf=ss.Ears(offset=(0.1, 0.0, 0.0))) as ds:
        made = ss.torch.Renderer(ds).binaural(PAIRS, HEADS[:, 0])
        _close(made, [ds.binaural(s, l, h) for (s, l), h in zip(PAIRS, HEADS[:, 0], strict=True)])


def test_stored_waveforms(tmp_path: Path, small_scene: ss.Scene) -> None:
    """Where waveforms are stored they are what the reader gives."""
    folder = ss.build_dataset(small_scene, tmp_path, small_job(store="both")).folder
    with ss.open_dataset(folder) as ds:
        renderer = ss.torch.Renderer(ds)
        for k, (s, l) in enumerate(PAIRS):
            np.testing.assert_array_equal(renderer.ambisonic(PAIRS)[k], ds.ambisonic(s, l))
            np.testing.assert_array_equal(renderer.binaural(PAIRS, 90.0)[k], ds.binaural(s, l, 90.0))
        _close(renderer.ambisonic(PAIRS, 8000), [ds.ambisonic(s, l, 8000) for s, l in PAIRS])


def test_noise_has_the_readers_counters() -> None:
    pairs = np.array([(0, 0), (3, 17), (900, 2**31)])
    for seed in (0, 5, 2**63):
        made = torch_signals.pair_seeds(seed, pairs)
        assert [int(x) for x in made] == [pair_seed(seed, int(s), int(l)) for s, l in pairs]
    keys = np.array([1, 2**64 - 1], np.uint64)
    wanted = [int(combine(k, 12)) for k in keys]
    assert [int(x) for x in torch_signals.combined_keys(keys, 12)] == wanted


# Materials, and gradients


def test_materials_by_name(counted: Path) -> None:
    with ss.open_dataset(counted) as ds:
        name = ds.materials[0].name
        made = ss.torch.Renderer(ds).ambisonic(PAIRS, materials={name: 0.35})
        _close(made, [ds.rendered(ds.echogram(*p, materials={name: 0.35}), *p) for p in PAIRS])
    with ss.open_dataset(counted, materials={name: 0.35}) as ds:
        _close(ss.torch.Renderer(ds).binaural(PAIRS), [ds.binaural(*p) for p in PAIRS])


@pytest.mark.parametrize("gradients", [False, True])
@pytest.mark.parametrize("renderer", ["default", "paper"])
def test_absorption_as_a_tensor(counted: Path, gradients: bool, renderer: str) -> None:
    """As the reader with the same absorption. With gradients, tensors take the place of compiled kernels."""
    with ss.open_dataset(counted, renderer=renderer) as ds:
        material = ds.materials[0]
        now = [material.absorption * 1.2, *(m.absorption for m in ds.materials[1:])]
        absorption = torch.tensor(np.array(now))
        absorption.requires_grad_(gradients)
        made = ss.torch.Renderer(ds).ambisonic(PAIRS, materials=absorption)
        assert made.requires_grad == gradients
        given = {material.name: (material.absorption * 1.2).tolist()}
        _close(made, [ds.rendered(ds.echogram(*p, materials=given), *p) for p in PAIRS])
        heard = ss.torch.Renderer(ds).microphones(PAIRS[:2], ARRAY, materials=absorption)
        with ss.open_dataset(counted, materials=given) as other:
            _close(heard, [other.microphones(s, l, ARRAY) for s, l in PAIRS[:2]])


@pytest.mark.parametrize("step", [1.15, 0.87])
def test_gradients_to_materials_are_those_of_the_readers_responses(counted: Path, step: float) -> None:
    """Of a weighted sum of a response's samples, by central differences of responses that the reader makes, each
    rounded to single precision; of what absorbs more and what absorbs less."""
    p, h = (0, 3), 4e-3
    with ss.open_dataset(counted) as ds:
        at = np.array([m.absorption * step for m in ds.materials])
        response = ds.ambisonic(*p)
        weight = np.random.default_rng(0).standard_normal(response.shape) * np.sign(response)

        def value(absorption: np.ndarray) -> float:
            given = {m.name: absorption[k] for k, m in enumerate(ds.materials)}
            made = ds.rendered(ds.echogram(*p, materials=given, force=True), *p)
            return float((weight * made).sum())

        absorption = torch.tensor(at, requires_grad=True)
        made = ss.torch.Renderer(ds).ambisonic(p, materials=absorption, force=True)[0]
        (torch.tensor(weight) * made).sum().backward()
        found = absorption.grad.numpy()
        for m, b in np.ndindex(at.shape):
            off = np.zeros_like(at)
            off[m, b] = h
            wanted = (value(at + off) - value(at - off)) / (2.0 * h)
            assert found[m, b] == pytest.approx(wanted, rel=0.02, abs=0.02 * np.abs(found).max())
        assert (np.abs(found).max(axis=0) > 0.0).all()


def test_gradients_are_finite_where_nothing_arrives(counted: Path) -> None:
    """Before the first sound and where a direction is known no root of zero has a gradient."""
    with ss.open_dataset(counted) as ds:
        absorption = torch.tensor(np.array([m.absorption for m in ds.materials]), requires_grad=True)
        renderer = ss.torch.Renderer(ds)
        loss: Any = (renderer.binaural(PAIRS, 20.0, materials=absorption) ** 2).sum()
        loss.backward()
        assert torch.isfinite(absorption.grad).all() and (absorption.grad != 0.0).any()


def test_absorption_that_cannot_be_is_refused(counted: Path, dataset_folder: Path) -> None:
    with ss.open_dataset(counted) as ds:
        renderer, now = ss.torch.Renderer(ds), np.array([m.absorption for m in ds.materials])
        with pytest.raises(
            ss.MaterialError, match=r"expected absorption of shape \(3, \d\) or \(5, 3, \d\)"
        ):
            renderer.ambisonic(PAIRS, materials=torch.zeros(3, 9))
        for wrong in (1.5, -0.1, float("nan")):
            with pytest.raises(ss.MaterialError, match=r"must lie from 0 to below what"):
                renderer.ambisonic(PAIRS, materials=torch.full(now.shape, wrong))
        with pytest.raises(ss.MaterialError, match=r"absorption of .* changes too much"):
            renderer.ambisonic(PAIRS, materials=torch.full(now.shape, 0.98))
        assert (
            renderer.ambisonic(PAIRS, materials=torch.full(now.shape, 0.98), force=True).isfinite().all()
        )
        with pytest.raises(ss.ConfigError, match="omnidirectional ends"):
            renderer.ambisonic(PAIRS, materials=torch.tensor(now), source="talker")
    with (
        ss.open_dataset(counted, renderer="smooth") as ds,
        pytest.raises(ss.ConfigError, match="no gradients pass through 'smooth'"),
    ):
        ss.torch.Renderer(ds).ambisonic(PAIRS, materials=torch.tensor(now, requires_grad=True))
    with ss.open_dataset(dataset_folder) as ds, pytest.raises(ss.DatasetError, match="no counts"):
        ss.torch.Renderer(ds).ambisonic(PAIRS, materials=torch.zeros(1, 4))


# Targets and dry sounds


def test_targets_are_those_of_random_rooms(dataset_folder: Path) -> None:
    with ss.open_dataset(dataset_folder) as ds:
        renderer, c = ss.torch.Renderer(ds), ds.manifest.config.simulation.c
        heard = renderer.microphones(PAIRS, ARRAY)
        for after in (0.0025, 0.05):
            made = renderer.until(heard, PAIRS, after, array=ARRAY)
            places = ds.points[PAIRS[:, 1]][:, None] + ARRAY.offsets
            way = np.linalg.norm(ds.points[PAIRS[:, 0]][:, None] - places, axis=2) / c
            wanted = _until({"rir": heard.numpy(), "arrival_s": way}, after, ds.rate)
            np.testing.assert_array_equal(made, wanted)
            assert (made != 0.0).any() and (made != heard).any()


def test_dry_sounds_and_their_gradients(dataset_folder: Path) -> None:
    """The gradient of w.(r * d) to d is the correlation of w with r."""
    rng = np.random.default_rng(1)
    with ss.open_dataset(dataset_folder) as ds:
        renderer = ss.torch.Renderer(ds)
        responses = renderer.binaural(PAIRS, 45.0)
        dry = torch.tensor(rng.standard_normal((5, 700)).astype(np.float32), requires_grad=True)
        heard = renderer.convolve(dry, responses)
        wanted = fftconvolve(responses.numpy().astype(float), dry.detach().numpy()[:, None], axes=2)
        assert heard.shape == wanted.shape
        np.testing.assert_allclose(heard.detach(), wanted, atol=1e-5 * np.abs(wanted).max())
        one = renderer.render(dry[0], PAIRS, 45.0)
        np.testing.assert_allclose(one.detach()[0], heard.detach()[0], atol=1e-6)
        np.testing.assert_allclose(
            one.detach()[2],
            ds.render(dry[0].detach().numpy(), 2, 6, 45.0),
            atol=1e-5 * np.abs(wanted).max(),
        )
        weight = rng.standard_normal(heard.shape)
        (torch.tensor(weight) * heard).sum().backward()
        for k in range(5):
            correlated = sum(
                np.correlate(weight[k, e], responses[k, e].numpy().astype(float), "valid")
                for e in (0, 1)
            )
            np.testing.assert_allclose(dry.grad[k], correlated, atol=1e-5 * np.abs(correlated).max())


def test_wrong_arguments_are_named(dataset_folder: Path) -> None:
    with ss.open_dataset(dataset_folder) as ds:
        renderer = ss.torch.Renderer(ds)
        scenes: Any = ss.open_datasets(dataset_folder.parent)
        wrong: list[tuple[Callable[[], Any], str]] = [
            (lambda: ss.torch.Renderer(scenes), r"dataset: expected a dataset"),
            (lambda: ss.torch.Renderer(ds, "abacus"), r"device: 'abacus' is not to be had here"),
            (lambda: ss.torch.Renderer(ds, "meta"), r"device: expected one that holds numbers"),
            (lambda: ss.torch.Renderer(ds, at_once=0), r"at_once: expected 1"),
            (lambda: ss.torch.Renderer(ds, cache_mb=float("nan")), r"cache_mb: expected 0"),
            (lambda: renderer.ambisonic(np.empty((0, 2), int)), r"pairs: expected at least one"),
            (lambda: renderer.ambisonic([(0, 99)]), r"pair \[0, 99\] is out of range"),
            (lambda: renderer.ambisonic([(0, 1)], order=1), r"order: expected 3 to 7"),
            (lambda: renderer.ambisonic([(0, 1)], rate=100), r"rate: expected"),
            (lambda: renderer.binaural(PAIRS, [0.0, 90.0]), r"headings_deg: expected one, 5 of them"),
            (lambda: renderer.binaural(PAIRS, float("nan")), r"headings_deg: expected finite angles"),
            (lambda: renderer.binaural(PAIRS, source=["talker"]), r"source: expected one or 5"),
            (lambda: renderer.convolve(torch.zeros(3, 9), torch.zeros(2, 1, 9)), r"audio: expected mono"),
            (lambda: renderer.until(torch.zeros(2, 1, 9), PAIRS), r"responses: expected \(5, channels, n\)"),
            (lambda: renderer.until(torch.zeros(5, 1, 9), PAIRS, -1.0), r"after_s: expected 0 s or more"),
            (lambda: renderer.rendered([], PAIRS), r"echograms: expected one for each of 5"),
        ]  # fmt: skip
        for call, message in wrong:
            with pytest.raises(ss.SoundSpacesSimError, match=message):
                call()
    assert set(RENDERERS) == set(torch_renderer._RENDERERS)
