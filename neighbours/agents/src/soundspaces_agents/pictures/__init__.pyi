"""The names that other packages use, and where they live."""

from .replay import write_replay
from .report import copy_report, write_page, write_replays, write_report

__all__ = ["copy_report", "write_page", "write_replay", "write_replays", "write_report"]
