"""Whether the free surface of a tissue is unique after the tool lets go."""

from __future__ import annotations

import numpy as np

from tissueid.model.kelvin_voigt import kelvin_voigt


def test_a_stiffening_tissue_with_constant_k_has_one_free_surface() -> None:
    model = kelvin_voigt(branches=1, stiffness_degree=0, depth_mm=8.0)
    assert model.contact_loss_is_unique(np.array([20.0, -1.2, 0.35, 63.62, 0.021]))


def test_k_that_grows_faster_than_the_static_force_has_several() -> None:
    # F_s = 10 x, K = 0.1 + x^2: at x = 3, (F_s / K)' = (10 K - F_s K') / K^2 = (91 - 180) / 82.8 = -1.07
    model = kelvin_voigt(branches=1, stiffness_degree=2, depth_mm=8.0)
    x, k, slope = 3.0, 0.1 + 9.0, 6.0
    assert (10.0 * k - 10.0 * x * slope) / k**2 < -1.0
    assert not model.contact_loss_is_unique(np.array([10.0, 0.0, 0.0, 0.1, 0.0, 1.0, 0.5]))


def test_an_elastic_tissue_has_nothing_to_recover() -> None:
    model = kelvin_voigt(branches=0, stiffness_degree=0, depth_mm=2.0)
    assert model.contact_loss_is_unique(np.array([1.0, 0.0, 0.0]))
