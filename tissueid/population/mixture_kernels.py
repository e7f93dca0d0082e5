"""The smooth likelihood of one specimen, compiled."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from tissueid.arrays import FloatArray
from tissueid.compiled import kernel

#: A quantity is never looked at beyond e to this, times its typical value.
LARGEST = 50.0


@kernel()
def log_mixture(
    phi: FloatArray, linear: NDArray[np.bool_], centre: FloatArray, log_weight: FloatArray,
    mean: FloatArray, unit: FloatArray,
) -> float:  # fmt: skip
    """Ln of a mixture of normals at a point, up to a constant.

    ``phi`` (p,); ``linear`` (p,): coordinates that the mixture has in the quantity itself, over exp(centre),
    not in its logarithm; ``centre`` (p,); ``log_weight`` (c,): of each component, its determinant included;
    ``mean`` (c, p); ``unit`` (c, p, p): inverse Cholesky factors.
    """
    p = phi.size
    x = np.empty(p)
    for k in range(p):
        x[k] = phi[k] - centre[k]
        if linear[k]:
            x[k] = math.exp(min(x[k], LARGEST))
    best = -np.inf
    value = np.empty(log_weight.size)
    for c in range(log_weight.size):
        square = 0.0
        for i in range(p):
            z = 0.0
            for j in range(i + 1):
                z += unit[c, i, j] * (x[j] - mean[c, j])
            square += z * z
        value[c] = log_weight[c] - 0.5 * square
        best = max(best, value[c])
    if not best > -np.inf:
        return -np.inf
    total = 0.0
    for c in range(value.size):
        total += math.exp(value[c] - best)
    return best + math.log(total)
