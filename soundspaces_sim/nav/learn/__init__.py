"""Learning to navigate (extra ``train``: PyTorch): the paper's network, PPO, DAgger, checkpoints."""
