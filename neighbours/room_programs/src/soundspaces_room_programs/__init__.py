"""Scenes of room-acoustics programs: CATT-Acoustic, ODEON, I-Simpa, and Gmsh.

Where it is installed, `soundspaces_sim.load_scene` reads them.
"""
