"""Forty colours of D3 (Bostock): its categories 20 and 20b, by the name of `habitat_sim.utils.common`."""

from __future__ import annotations

import numpy as np

_HEX = """
1f77b4 aec7e8 ff7f0e ffbb78 2ca02c 98df8a d62728 ff9896 9467bd c5b0d5
8c564b c49c94 e377c2 f7b6d2 7f7f7f c7c7c7 bcbd22 dbdb8d 17becf 9edae5
393b79 5254a3 6b6ecf 9c9ede 637939 8ca252 b5cf6b cedb9c 8c6d31 bd9e39
e7ba52 e7cb94 843c39 ad494a d6616b e7969c 7b4173 a55194 ce6dbd de9ed6
"""
#: (40, 3) red, green and blue, 0 to 255.
d3_40_colors_rgb = np.array([list(bytes.fromhex(color)) for color in _HEX.split()], np.uint8)
