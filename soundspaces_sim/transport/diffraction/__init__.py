"""Diffraction at wedges: single, double, mixed with reflections, and at the ends of finite reflectors."""
