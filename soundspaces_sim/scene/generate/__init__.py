"""Scenes made by code: the demo, numbered flats and buildings of other types."""
