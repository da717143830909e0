"""Scenes made by code: the demo and numbered flats."""
