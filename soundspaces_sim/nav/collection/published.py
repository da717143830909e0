"""Reverberation times that were published of rooms such as generated buildings have: from, to (s), and what it is.

Sources: [1] Jackson and Leventhall, "The acoustics of domestic rooms", Applied Acoustics 5 (1972), means over 50
living
rooms; [2] 16 living rooms measured by the BBC, as quoted with [1] in Everest, "The Master Handbook of Acoustics",
ch. 7; [3] to [5] are recommendations: "Classroom Acoustics", Acoustical Society of America; Acoustical Solutions;
PanAcoustics.
"""

from collections.abc import Mapping, Sequence

_HOMES = (
    (0.40, 0.69, "50 living rooms, means\n8 kHz to 125 Hz [1]"),
    (0.35, 0.45, "16 living rooms [2]"),
)
PUBLISHED: Mapping[str, Sequence[tuple[float, float, str]]] = {
    "home": _HOMES,
    "room": _HOMES,
    "classroom": ((0.4, 0.6, "recommended [3]"),),
    "hall": ((1.25, 1.75, "recommended, gyms [4]"),),
    "church": ((1.5, 2.5, "recommended [5]"),),
}
