"""Porous materials of published rooms by angle, all others at random incidence: a rule between the two laws.

A surface reacts locally where what enters it goes along its normal, whatever the angle of incidence: then one
impedance holds for all angles. Porous layers do, as sound is slow in them and refracted towards the normal; so
does upholstery. docs/validation.md compares this rule with either law for all walls.
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
