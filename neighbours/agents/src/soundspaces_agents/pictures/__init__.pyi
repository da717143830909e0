"""The names that other packages use, and where they live."""

from .replay import write_replay
from .report import write_replays, write_report

__all__ = ["write_replay", "write_replays", "write_report"]
