"""Counts of reflections: how often late and scattered sound has met each group of materials (theory, section 11).

An estimator of its own makes every path that the time bins of an echogram hold, with few subpaths (`count`), and
keeps means and covariances of how often these were reflected by each group (`groups`), per pair, window of time and
band. The other techniques know nothing of it, and a simulation without it is the same to the bit.
"""
