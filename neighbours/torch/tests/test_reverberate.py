"""Whole batches of `TorchRirDataset` on a device, and reverberation as a module, against the NumPy reader."""

from __future__ import annotations

from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest

import soundspaces_sim as ss
from neighbours.torch.tests.test_torch import several as several

torch = pytest.importorskip("torch", reason="the extra 'torch' is not installed")

from soundspaces_torch import Renderer, Reverberate  # noqa: E402

from soundspaces_sim.torch import TorchRirDataset  # noqa: E402


@pytest.mark.parametrize("kind", ["binaural", "ambisonic"])
@pytest.mark.parametrize("seed", [3, None])
def test_a_device_renders_whole_batches(several: Path, kind: str, seed: int | None) -> None:
    """The items of the NumPy reader, the draws of headings included; in workers too, on a processor."""
    with ss.open_datasets(several) as scenes:
        plain = TorchRirDataset(scenes, samples=900, kind=kind, seed=seed)
        device = TorchRirDataset(scenes, samples=900, kind=kind, seed=seed, device="cpu")
        rows = [0, 70, 3, 111]
        torch.manual_seed(1)
        wanted = [plain[k] for k in rows]
        torch.manual_seed(1)
        made = device.__getitems__(rows)
        for one, two in zip(wanted, made, strict=True):
            assert one.keys() == two.keys()
            torch.testing.assert_close(
                two["rir"], one["rir"], rtol=0.0, atol=1e-4 * float(one["rir"].abs().max())
            )
            for name in set(one) - {"rir"}:
                torch.testing.assert_close(two[name], one[name], equal_nan=True) if isinstance(
                    one[name], torch.Tensor
                ) else np.testing.assert_equal(two[name], one[name])
        if seed is not None:
            for workers in (0, 1):
                loader = torch.utils.data.DataLoader(device, batch_size=50, num_workers=workers)
                batch = next(iter(loader))
                assert batch["rir"].shape == (50, 2 if kind == "binaural" else 9, 900)
                torch.testing.assert_close(batch["rir"][3], device[3]["rir"], rtol=0.0, atol=1e-6)


def test_reverberation_as_a_module(dataset_folder: Path) -> None:
    rng = np.random.default_rng(0)
    dry = torch.tensor(rng.standard_normal((3, 800)).astype(np.float32))
    pairs = np.array([(0, 3), (2, 6), (7, 1)])
    with ss.open_dataset(dataset_folder) as ds:
        renderer = Renderer(ds)
        module = Reverberate(renderer, headings_deg=(90.0,))
        assert isinstance(module, torch.nn.Module) and not list(module.parameters())
        heard = module(dry, pairs, sample_rate=16000)
        whole = Reverberate(renderer, headings_deg=(90.0,), full=True)(dry[:, None], pairs)
        for k, p in enumerate(pairs):
            want = ds.render(dry[k].numpy(), p[0], p[1], 90.0)
            close = 1e-4 * np.abs(want).max()
            assert np.abs(whole[k].numpy() - want).max() <= close
            assert np.abs(heard[k].numpy() - want[:, :800]).max() <= close
        chain = torch.nn.Sequential(Reverberate(renderer, pairs, "monaural"), torch.nn.Flatten())
        assert chain(dry).shape == (3, 800)
        array = ss.MicrophoneArray([[0.1, 0, 0], [-0.1, 0, 0]])
        reverberant, early = Reverberate(renderer, pairs, array, target_s=0.0025)(dry, pairs)
        assert reverberant.shape == early.shape == (3, 2, 800)
        response = ds.microphones(0, 3, array)
        last = np.linalg.norm(ds.points[0] - ds.points[3] - array.offsets, axis=1) / 343.0 + 0.0025
        response = np.where(np.arange(response.shape[1]) / 16000 <= last[:, None], response, 0.0)
        for k in range(2):
            want = np.convolve(dry[0].numpy(), response[k])[:800]
            assert np.abs(early[0, k].numpy() - want).max() <= 1e-4 * np.abs(want).max()


def test_drawn_pairs_and_shares_of_the_module(dataset_folder: Path) -> None:
    """PyTorch's generator draws; what is not reverberated stays as it is."""
    dry = torch.randn(40, 300)
    with ss.open_dataset(dataset_folder) as ds:
        module = Reverberate(Renderer(ds), [(0, 3), (2, 6)], "monaural", p=0.5)
        torch.manual_seed(2)
        one = module(dry)
        torch.manual_seed(2)
        torch.testing.assert_close(module(dry), one)
        plain = (one[:, 0] == dry).all(dim=1)
        assert 8 <= int(plain.sum()) <= 32  # 3.8 standard deviations
        pairs = Reverberate(Renderer(ds)).pairs
        assert len(pairs) == 56 and (pairs[:, 0] != pairs[:, 1]).all()


def test_aligned_reverberation_begins_with_the_signal(dataset_folder: Path) -> None:
    click = torch.zeros(1, 800)
    click[0, 100] = 1.0
    with ss.open_dataset(dataset_folder) as ds:
        s, l = next(p for p in ds.sample(50, 0, visible=(1, 1), distance=(2.0, 9.0)))
        late = float(np.linalg.norm(ds.points[s] - ds.points[l])) / 343.0 * 16000
        for align, at in ((False, 100.0 + late), (True, 100.0)):
            made = Reverberate(Renderer(ds), kind="monaural", align=align)(click, [(s, l)])
            assert abs(int(made[0, 0].abs().argmax()) - at) <= 1.0


def test_wrong_use_of_the_module_is_named(dataset_folder: Path) -> None:
    with ss.open_dataset(dataset_folder) as ds:
        renderer = Renderer(ds)
        module, stereo = Reverberate(renderer), cast(Any, "stereo")
        for call, message in (
            (
                lambda: Reverberate(renderer, kind=stereo),
                "kind: expected binaural, ambisonic, monaural or",
            ),
            (lambda: Reverberate(renderer, p=1.5), "p: expected 0 to 1"),
            (lambda: Reverberate(renderer, headings_deg=()), "headings_deg: expected one or more"),
            (lambda: Reverberate(renderer, [(0, 99)]), r"pair \[0, 99\] is out of range"),
            (
                lambda: module(torch.zeros(2, 3, 9)),
                r"samples: expected mono signals, .* got \(2, 3, 9\)",
            ),
            (
                lambda: module(torch.zeros(2, 9), [(0, 1)]),
                "pairs: expected one for each of 2 signals, got 1",
            ),
            (lambda: module(torch.zeros(2, 9), sample_rate=44100), "open it with rate=44100"),
        ):
            with pytest.raises(ss.SoundSpacesSimError, match=message):
                call()
