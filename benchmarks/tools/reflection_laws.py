"""Which materials of published rooms react locally, by a rule that was stated before it was tried.

A surface reacts locally where what enters it goes along its normal, whatever the angle of incidence: then one
impedance holds for all angles. Porous layers do, as sound is slow in them and refracted towards the normal; so
does upholstery. Plates (panels, glass, boards, floors on joists) do not: bending waves run along them. Of hard
walls a coefficient of some per cent tells the loss at joints and edges, which has no known law of angles. So:
what is porous absorbs by angle, all else as at random incidence.
"""

from __future__ import annotations

from dataclasses import replace

import soundspaces_sim as ss

#: Beginnings of names: curtains and acoustic tiles of PTB's studio, seats of Elmia. The seminar room has none.
POROUS = ("curtain", "wilhelmi", "audience")


def with_local_reaction(scene: ss.Scene) -> ss.Scene:
    """The scene whose porous materials, by `POROUS`, reflect by angle."""
    table = scene.materials
    laws = tuple("angle" if name.startswith(POROUS) else "" for name in table.names)
    return replace(scene, materials=replace(table, reflection=laws))
