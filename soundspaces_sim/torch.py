"""For PyTorch (extra ``torch``): responses on a device, datasets for loaders, reverberation as a module.

    import soundspaces_sim as ss
    import soundspaces_sim.torch
    renderer = ss.torch.Renderer(ss.open_dataset("out/demo", rate=16000), device="cuda")
    responses = renderer.binaural(renderer.dataset.sample(256), headings_deg=90.0)  # (256, 2, n)

Names are loaded when they are first used.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from soundspaces_sim.dataset.torch_dataset import TorchRirDataset as TorchRirDataset
    from soundspaces_sim.dataset.torch_renderer import Renderer as Renderer
    from soundspaces_sim.dataset.torch_reverberate import Reverberate as Reverberate

_WHERE = {
    "Renderer": "soundspaces_sim.dataset.torch_renderer",
    "Reverberate": "soundspaces_sim.dataset.torch_reverberate",
    "TorchRirDataset": "soundspaces_sim.dataset.torch_dataset",
}
__all__ = list(_WHERE)


def __getattr__(name: str) -> Any:
    if name not in _WHERE:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_WHERE[name]), name)


def __dir__() -> list[str]:
    return sorted(_WHERE)
