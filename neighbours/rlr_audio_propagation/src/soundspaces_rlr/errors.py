"""The error of this interface: its clients expect RuntimeError."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from soundspaces_sim import SoundSpacesSimError


class RlrError(SoundSpacesSimError, RuntimeError):
    """A call of the `rlr_audio_propagation` interface cannot be carried out."""


@contextmanager
def as_runtime_errors() -> Iterator[None]:
    """Errors of the package, raised within, become `RlrError`."""
    try:
        yield
    except RlrError:
        raise
    except SoundSpacesSimError as error:
        raise RlrError(str(error)) from error
