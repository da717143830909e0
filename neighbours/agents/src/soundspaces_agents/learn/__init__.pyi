"""The public names and where they live; a name is loaded when it is first used, and PyTorch with it."""

from .checkpoint import load_trained
from .train import Run, one_thread, shortened, train_agent

__all__ = ["Run", "load_trained", "one_thread", "shortened", "train_agent"]
