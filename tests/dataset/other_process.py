"""What a process reads that is started anew: with this module it loads nothing that tests alone need."""

import numpy as np

import soundspaces_sim as ss


def read_one(ds: ss.RirDataset) -> np.ndarray:
    return ds.binaural(0, 1)
