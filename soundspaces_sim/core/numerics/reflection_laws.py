"""The table of reflection laws: how the energy that a surface returns depends on the angle of incidence.

A law is a module of `transport.bsdf`, which says what it has to hold, and a row here. Materials choose theirs by
name (`scene.materials`), and a job that of all others (`SimulationConfig.reflection`).
"""

from typing import TYPE_CHECKING, Literal

from soundspaces_sim.core.registry import Entry

#: The module of each law by its name, and what it does; the first one knows no angles.
REFLECTION_LAWS = {
    "random": Entry(
        "soundspaces_sim.transport.bsdf.random_incidence", "at every angle as at random incidence"
    ),
    "angle": Entry("soundspaces_sim.transport.bsdf.impedance", "by angle, as locally reacting walls do"),
}

if TYPE_CHECKING:
    LawName = str
else:
    LawName = Literal[tuple(REFLECTION_LAWS)]  # the type of a setting that names one
