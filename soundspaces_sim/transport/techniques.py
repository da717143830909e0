"""All techniques, in the order in which they run: the table of which path is whose.

A new technique is a module with its record, and its line here.
"""

from soundspaces_sim.transport.diffraction.technique import (
    COHERENCE,
    DOUBLE,
    FINITE_REFLECTORS,
    MIXED,
    SHADOW_BOUND,
    SINGLE,
)
from soundspaces_sim.transport.image_source.technique import IMAGE_SOURCE
from soundspaces_sim.transport.paths.technique import CONNECTIONS, DIRECT, RECEIVER_VOLUMES, SPECULAR
from soundspaces_sim.transport.radiance_transfer.technique import RADIANCE_TRANSFER

import os
from dataclasses import replace
from soundspaces_sim.transport.arrivals.technique import ARRIVALS
TECHNIQUES = (ARRIVALS, replace(IMAGE_SOURCE, connect=None), SPECULAR, RECEIVER_VOLUMES, CONNECTIONS, RADIANCE_TRANSFER) if not os.environ.get('SS_OLD') else (
    DIRECT,
    SINGLE,
    DOUBLE,
    SHADOW_BOUND,
    IMAGE_SOURCE,
    FINITE_REFLECTORS,
    MIXED,
    COHERENCE,
    SPECULAR,
    RECEIVER_VOLUMES,
    CONNECTIONS,
    RADIANCE_TRANSFER,
)
