"""Worlds whose up is not y, turned so that it is."""

from collections.abc import Mapping

import numpy as np

R_UPRIGHT_WORLD: Mapping[str, np.ndarray] = {
    "y": np.array([[1.0, 0, 0], [0, 1, 0], [0, 0, 1]]),
    "-y": np.array([[1.0, 0, 0], [0, -1, 0], [0, 0, -1]]),
    "z": np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]]),
    "-z": np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]]),
    "x": np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]]),
    "-x": np.array([[0.0, 1, 0], [-1, 0, 0], [0, 0, 1]]),
}
"""By the axis of the world that points up: the rotation that makes it y."""
