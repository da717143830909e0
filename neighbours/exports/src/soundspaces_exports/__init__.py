"""Datasets in the layouts of other programs, and graphs of SoundSpaces 1: for `soundspaces-sim export`."""
