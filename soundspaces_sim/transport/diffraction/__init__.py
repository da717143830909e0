"""Diffraction at wedges: single, double, mixed with reflections, and at the ends of finite reflectors."""

from soundspaces_sim.core.numerics.records import pass_whole

pass_whole(__name__)
