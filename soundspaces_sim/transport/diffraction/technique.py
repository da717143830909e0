"""Diffraction at wedges as techniques: single, double, at the ends of reflectors, and mixed with a reflection."""

from soundspaces_sim.transport.diffraction import (
    coherence,
    double,
    finite_reflectors,
    mixed,
    shadow_bound,
    single,
)
from soundspaces_sim.transport.diffraction.prepared import prepare_wedges
from soundspaces_sim.transport.technique import Technique

SINGLE = Technique(
    "diffraction",
    "past one wedge, out of sight; it corrects the direct sound near shadow boundaries",
    prepare=prepare_wedges,
    connect=single.connect,
    requires=("direct",),
)
DOUBLE = Technique(
    "double_diffraction",
    "past two wedges, out of sight",
    prepare=prepare_wedges,
    connect=double.connect,
    requires=("direct",),
)
SHADOW_BOUND = Technique(
    "shadow_bound",
    "none: direct sound and paths round edges are together no louder than an edge leaves them",
    connect=shadow_bound.connect,
    requires=("direct", "diffraction"),
)
FINITE_REFLECTORS = Technique(
    "finite_reflectors",
    "by the edges of a reflector, beside its reflection; it corrects reflections near those edges",
    prepare=prepare_wedges,
    connect=finite_reflectors.connect,
    requires=("direct", "image_source"),
)
MIXED = Technique(
    "mixed_diffraction",
    "one reflection and one wedge, in either order; it corrects reflections that pass wedges",
    prepare=prepare_wedges,
    connect=mixed.connect,
    requires=("direct", "image_source"),
)
COHERENCE = Technique(
    "coherence",
    "none: it corrects the levels of discrete paths that arrive together by their phases",
    connect=coherence.connect,
    requires=("direct", "diffraction"),
)
