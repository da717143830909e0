"""The law without angles: a surface reflects at every angle what it reflects at random incidence."""

import numpy as np

from soundspaces_sim.core.numerics.kernel import part


def parameters(absorption: np.ndarray, transmission: np.ndarray, free: np.ndarray) -> np.ndarray:
    return np.zeros((len(absorption), 2, absorption.shape[1], 0))


@part(forceinline=True)
def factor(parameters: np.ndarray, cos: float) -> float:
    return 1.0
