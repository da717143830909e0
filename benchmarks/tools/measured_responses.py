"""Measured responses of rooms in public repositories: where they lie, and what of them is read.

MEASURED_RESPONSES names a folder with checkouts of the repositories below, each as ``OWNER/NAME``. None is part of
this project; each repository says under which licence its files are. Only files are used of which it is said, or
known from their collection, that they were measured in a room; those of unknown origin and of places outdoors are
not. Rooms of one building are taken as different rooms.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import scipy.io
import soundfile
from scipy.signal import resample_poly
from soundspaces_tasks.setting import RATE

FOLDER = Path(os.environ.get("MEASURED_RESPONSES", "measured-responses"))
_CHROME = "GoogleChrome/web-audio-samples", "a40fe65", "archive/demos/impulse-responses/"
_OPENAIR = "miltonlaufer/visualwebaudio", "57bcaa7", "public/audio/impulse-responses/"
_VERB = "QVbDev/quantumVerb", "6801e01", "Resources/ImpulseResponses/"
_PORI = tuple(f"binaural/s1_r{r}_b.wav" for r in (1, 2, 3, 4))


@dataclass(frozen=True)
class MeasuredResponses:
    """`files` of one room, below `start` in a repository at a commit."""

    name: str
    repository: str
    commit: str
    start: str
    files: tuple[str, ...]

    def read(self) -> list[np.ndarray]:
        """Every channel of every file, at `RATE`, (n,) each."""
        folder = FOLDER / self.repository
        return [channel for file in self.files for channel in _channels(folder / (self.start + file))]

    @property
    def there(self) -> bool:
        """Whether all files are."""
        return all((FOLDER / self.repository / (self.start + file)).is_file() for file in self.files)


ROOMS = (
    MeasuredResponses("cinema room of a house", *_CHROME, ("house-impulses/cinema-room.wav",)),
    MeasuredResponses("dining room of a house", *_CHROME, ("house-impulses/dining-room.wav",)),
    MeasuredResponses("kitchen of a house", *_CHROME, ("house-impulses/kitchen.wav",)),
    MeasuredResponses(
        "warehouse", *_CHROME, tuple(f"tim-warehouse/omni-{d}/omni-{d}.wav" for d in ("7-4", "15-10"))
    ),
    MeasuredResponses("concert hall in Pori", *_CHROME, _PORI),
    MeasuredResponses(
        "bedroom of the MIT survey", "frummer/CommonVoice_RIR", "8e963ef", "rir_experiments/",
        ("h001_Bedroom_65txts.wav",),
    ),
    MeasuredResponses(
        "living room of DIRHA", "mravanelli/pySpeechRev", "001e511", "IR_examples/",
        ("IR1_16.mat", "IR2_16.mat", "IR3_16.mat"),
    ),
    MeasuredResponses(
        "seminar room in Rostock", "spatialaudio/selected-topics-in-audio-signal-processing-exercises",
        "ca28a2a", "data/", ("rir_clap.wav",),
    ),
    MeasuredResponses(
        "living room of OpenAIR", "python-acoustics/python-acoustics", "99d7920", "tests/data/",
        ("living_room_1.wav",),
    ),
    MeasuredResponses(
        "sports centre in York", "python-acoustics/python-acoustics", "99d7920", "tests/data/",
        ("ir_sportscentre_omni.wav",),
    ),
    MeasuredResponses("St Andrew's church", *_VERB, ("large_church.wav",)),
    MeasuredResponses("Terry's typing room", *_VERB, ("large_hall.wav",)),
    MeasuredResponses("Tyndall Bruce monument", *_VERB, ("medium_chamber.wav",)),
    MeasuredResponses("basement of OpenAIR", *_OPENAIR, ("basement.wav",)),
    MeasuredResponses("stairwell of OpenAIR", *_OPENAIR, ("stairwell.wav",)),
    MeasuredResponses("Spokane Woman's Club", *_OPENAIR, ("chapel.wav",)),
    MeasuredResponses("Hamilton mausoleum", *_OPENAIR, ("mausoleum.wav",)),
    MeasuredResponses(
        "laboratory of Kagawa", "kitamura-laboratory/rt60", "c9e6aee", "",
        ("impResponse_short.wav", "impResponse_long.wav"),
    ),
    MeasuredResponses(
        "powder magazine of Fort Flagler", "hankyates/norns-convolution-reverb", "55d9863", "assets/",
        ("fort-flagler-powder-room-stereo.wav",),
    ),
    MeasuredResponses(
        "hall of C4DM", "Landerson65/Room-Impulse-Response", "ed1a526", "Original RIRs/",
        ("00x00y.wav", "40x15y.wav"),
    ),
)  # fmt: skip


def _channels(path: Path) -> list[np.ndarray]:
    if path.suffix == ".mat":  # DIRHA's, at 16 kHz
        return [np.ravel(scipy.io.loadmat(path)["risp_imp"]).astype(float)]
    samples, rate = soundfile.read(path, always_2d=True)
    divisor = int(np.gcd(rate, RATE))
    return list(resample_poly(samples, RATE // divisor, rate // divisor, axis=0).T)
