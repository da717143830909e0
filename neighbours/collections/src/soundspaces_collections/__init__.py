"""Collections: many generated buildings as datasets with splits, episodes, statistics, checksums and a report.

from soundspaces_collections.pipeline import build_collection
"""
