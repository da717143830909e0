"""Acoustic radiance transfer between patches (Siltanen et al. 2007), by subpaths that all points share."""
