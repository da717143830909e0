"""Image sources as a technique."""

from soundspaces_sim.transport.image_source.image_source import connect
from soundspaces_sim.transport.image_source.prepared import mark_planes, prepare_planes
from soundspaces_sim.transport.technique import Technique

IMAGE_SOURCE = Technique(
    "image_source",
    "one or two specular reflections, all at grouped planes",
    prepare=prepare_planes,
    mark=mark_planes,
    connect=connect,
)
