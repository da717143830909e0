"""Responses of datasets as tensors on a device, with gradients, and reverberation as a module of PyTorch.

    import soundspaces_sim as ss, soundspaces_torch as st
    renderer = st.Renderer(ss.open_dataset("out/demo", rate=16000), device="cuda")

Names are loaded when they are first used.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
