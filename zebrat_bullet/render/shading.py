"""Light, worked out for each vertex in NumPy: the same from every view, cheap to rasterize, and nowhere black."""

import numpy as np
from numpy.typing import NDArray

_AMBIENT = 0.40
# Directions that light comes from, and their strengths; a wall of any bearing faces one of them.
_DIRECTIONS = np.array([(-0.5, -0.8, 1.4), (0.9, 0.35, 0.9), (-0.6, 0.9, 0.7)])
_DIRECTIONS /= np.linalg.norm(_DIRECTIONS, axis=1, keepdims=True)
_STRENGTHS = np.array([0.37, 0.25, 0.20])


def shade(colors: NDArray, normals_world: NDArray[np.float64]) -> NDArray[np.uint8]:
    """Return the (P, 3) lit colours of matt surfaces with (P, 3) colours in 0..255 and (P, 3) unit normals."""
    light = _AMBIENT + np.maximum(normals_world @ _DIRECTIONS.T, 0.0) @ _STRENGTHS
    return np.minimum(colors * light[:, None], 255.0).astype(np.uint8)
