"""What all readers of SOFA files (AES69) need: the convention's name, and the delays that go with responses."""

from __future__ import annotations

import h5py
import numpy as np

from soundspaces_sim.core.errors import SoundSpacesSimError
from soundspaces_sim.core.io.hdf5 import attribute, plain_dataset, read_numbers

_MOST_DELAY = 2**16  # samples


def check_convention(
    sofa: h5py.File, wanted: tuple[str, ...], where: str, error: type[SoundSpacesSimError]
) -> None:
    """Raise `error` for a file that says it follows another convention."""
    found = attribute(sofa, "SOFAConventions", where, error, "")
    if found and str(found).strip() not in wanted:
        raise error(
            f"{where}: expected SOFA convention {' or '.join(wanted)}, got {str(found)[:60]!r}, which "
            "holds something else"
        )


def data_delay(
    sofa: h5py.File, measurements: int, receivers: int, where: str, error: type[SoundSpacesSimError]
) -> np.ndarray:
    """(measurements, receivers) samples of Data.Delay, which is of all measurements or of each; 0 if there is
    none."""
    if "Data.Delay" not in sofa:
        return np.zeros((measurements, receivers))
    item = plain_dataset(sofa, "Data.Delay", where, error, "")
    if item.shape not in ((1, receivers), (measurements, receivers)):
        raise error(
            f"{where}: Data.Delay: expected shape (1, {receivers}) or ({measurements}, {receivers}), got "
            f"{item.shape}"
        )
    found = np.asarray(read_numbers(item, ..., where, error, ""), float)
    if not ((found >= 0.0) & (found <= _MOST_DELAY)).all():
        raise error(f"{where}: Data.Delay: expected 0 to {_MOST_DELAY:,} samples")
    return np.broadcast_to(found, (measurements, receivers))


def delayed(responses: np.ndarray, delay: np.ndarray) -> np.ndarray:
    """(…, n') responses (…, n), each later by its `delay` (…) in samples, which may be broken."""
    if not delay.any():
        return responses
    whole = np.floor(delay).astype(np.int64)
    n = responses.shape[-1]
    out = np.zeros((*responses.shape[:-1], n + int(np.ceil(delay.max()))))
    rest = delay - whole
    if rest.any():
        # A sinc between samples, by a ramp of phase; zeros before and behind keep its ends from meeting.
        size = 2 * n
        turn = np.exp(-2j * np.pi * np.fft.rfftfreq(size) * rest[..., None])
        responses = np.fft.irfft(np.fft.rfft(responses, size) * turn, size)[..., : n + 1]
    for at in np.ndindex(delay.shape):
        part = responses[at][: out.shape[-1] - whole[at]]
        out[at][whole[at] : whole[at] + len(part)] = part
    return out
