"""Learning to navigate (extra ``train``: PyTorch): the paper's network, PPO, DAgger, checkpoints."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
