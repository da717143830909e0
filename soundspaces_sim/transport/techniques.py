"""All techniques, in the order in which they run: the table of which path is whose.

A new technique is a module with its record, and its line here.
"""

from soundspaces_sim.transport.arrivals.technique import ARRIVALS
from soundspaces_sim.transport.paths.technique import CONNECTIONS, RECEIVER_VOLUMES, SPECULAR
from soundspaces_sim.transport.radiance_transfer.technique import RADIANCE_TRANSFER

TECHNIQUES = (ARRIVALS, SPECULAR, RECEIVER_VOLUMES, CONNECTIONS, RADIANCE_TRANSFER)
