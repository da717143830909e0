"""Scenes of HM3D and Gibson, IFC building models and COLLADA files."""
