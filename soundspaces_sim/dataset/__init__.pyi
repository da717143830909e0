"""The names that other packages use, and where they live."""

from .web import Web

__all__ = ["Web"]
