"""A toy law: energy in proportion to the cosine of the angle of incidence."""

import numpy as np

from soundspaces_sim.core.numerics.kernel import part


def parameters(absorption: np.ndarray, transmission: np.ndarray, free: np.ndarray) -> np.ndarray:
    return np.full((len(absorption), 2, absorption.shape[1], 1), 1.5)


@part(forceinline=True)
def factor(parameters: np.ndarray, cos: float) -> float:
    return parameters[0] * cos  # its mean over random incidence, of weight 2 cos, is one
