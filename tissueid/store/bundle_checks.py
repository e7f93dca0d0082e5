"""Requirements on a bundle's numbers: finite, a covariance, and a passive tissue in every draw."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tissueid.arrays import FloatArray
from tissueid.store.bundle_content import Bundle

#: A covariance that went through a Cholesky factor and back is positive semi-definite to rounding only.
_COVARIANCE_ROUNDING = 1e-9


def array_problem(bundle: Bundle) -> str | None:
    """Fault of the sizes and numbers of a bundle's arrays, ``None`` where nothing is."""
    size = len(bundle.theta_names)
    shapes: Sequence[tuple[str, FloatArray | None, tuple[int, ...]]] = (
        ("theta", bundle.theta, (size,)),
        ("covariance", bundle.covariance, (size, size)),
        *(
            (name, array, (-1 if array is None else len(array), size))
            for name, array in (
                ("draws", bundle.draws),
                ("population_mean", bundle.population_mean),
                ("population_sd", bundle.population_sd),
            )
        ),
    )
    for name, array, shape in shapes:
        if array is None:
            continue
        if array.shape != shape:
            return f"{name} has shape {array.shape}, the {size} parameters need {shape}"
        if not np.isfinite(array).all():
            return f"{name} holds {int((~np.isfinite(array)).sum())} numbers that are not finite"
    covariance = bundle.covariance
    scale = np.sqrt(np.abs(np.diag(covariance)))
    scale[scale == 0] = 1.0
    # judged on the correlations, so that units (N/mm beside s) do not hide a wrong small entry
    correlation = covariance / np.outer(scale, scale)
    if np.abs(correlation - correlation.T).max(initial=0.0) > _COVARIANCE_ROUNDING:
        return "the covariance is not symmetric"
    smallest = float(np.linalg.eigvalsh(correlation).min(initial=0.0))
    if smallest < -_COVARIANCE_ROUNDING * max(size, 1):
        return f"the covariance is not positive semi-definite (eigenvalue {smallest:.3g} of the correlations)"
    return None


def model_problem(bundle: Bundle) -> str | None:
    """Why the contact model of a bundle can't be rendered, ``None`` where it can."""
    try:
        model = bundle.contact_model()
    except (KeyError, ValueError) as error:
        return f"the contact model can't be built ({error})"
    if tuple(model.parameter_names) != bundle.theta_names:
        return (
            f"theta is {bundle.theta_names}, the model {bundle.model.key} has {tuple(model.parameter_names)}"
        )
    if not model.is_passive(bundle.theta):
        return "theta is not passive: it would put out more energy than was put in"
    if bundle.draws is not None:
        for row, draw in enumerate(bundle.draws):
            if not model.is_passive(draw):
                return f"draw {row} is not passive: it would put out more energy than was put in"
    return None
