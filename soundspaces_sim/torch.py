"""For PyTorch, by neighbours/torch: datasets for loaders, responses on a device, reverberation as a module.

    import soundspaces_sim as ss
    import soundspaces_sim.torch
    renderer = ss.torch.Renderer(ss.open_dataset("out/demo", rate=16000), device="cuda")
    responses = renderer.binaural(renderer.dataset.sample(256), headings_deg=90.0)  # (256, 2, n)

Names are loaded when they are first used.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from soundspaces_sim.core.registry import Entry, find

_WHERE: Mapping[str, Entry] = {
    "Renderer": Entry("soundspaces_torch.renderer:Renderer", "responses on a device", "renderers torch"),
    "Reverberate": Entry(
        "soundspaces_torch.reverberate:Reverberate", "reverberation as a module", "renderers torch"
    ),
    "TorchRirDataset": Entry(
        "soundspaces_torch.dataset:TorchRirDataset", "a dataset for loaders", "renderers torch"
    ),
}
__all__ = list(_WHERE)


def __getattr__(name: str) -> Any:
    if name not in _WHERE:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return find("soundspaces_sim.torch", _WHERE, name)


def __dir__() -> list[str]:
    return sorted(_WHERE)
