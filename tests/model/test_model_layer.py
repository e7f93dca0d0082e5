"""A layer under a tip: against elasticity solved another way, published factors and the half-space."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.linalg import expm
from scipy.special import j0, j1

from tissueid.model.moduli import MOST_A_OVER_H, compliance, flat_factor, layer_contact

#: Table 1 of Hayes et al. 1972 (flat punch, bonded layer, nu = 0.5), as printed: three decimals.
HAYES_FLAT_HALF = {0.2: 1.281, 0.4: 1.683, 0.6: 2.211, 0.8: 2.855}


def surface_compliance(x: float, poisson: float, *, bonded: bool) -> float:
    """M(x) from Navier's equations of one Fourier mode, integrated through the thickness.

    Plane strain, u = U(z) sin kx, w = W(z) cos kx, k = 1, thickness x; the state (U, W, shear, normal stress)
    obeys y' = A y.  Below, u and w (or w and the shear stress) vanish; above, a unit normal stress without
    shear.  The half-space answers with 2 (1 - nu) / (2 G) for a unit stress: M is the ratio.
    """
    shear, lame = 1.0, 2.0 * poisson / (1.0 - 2.0 * poisson)
    whole = lame + 2.0 * shear
    system = np.array(
        [
            [0.0, 1.0, 1.0 / shear, 0.0],
            [-lame / whole, 0.0, 0.0, 1.0 / whole],
            [whole - lame**2 / whole, 0.0, 0.0, lame / whole],
            [0.0, 0.0, -1.0, 0.0],
        ]
    )
    through = expm(system * x)
    free = [2, 3] if bonded else [0, 3]
    loads = through[np.ix_([2, 3], free)]
    start = np.linalg.solve(loads, np.array([0.0, 1.0]))
    return float(through[1, free] @ start) / ((1.0 - poisson) / shear)


@pytest.mark.parametrize("bonded", [True, False])
@pytest.mark.parametrize("poisson", [0.1, 0.3, 0.45])
def test_compliance_of_a_mode_is_that_of_navier_s_equations(poisson, bonded):
    for x in (0.05, 0.4, 1.0, 2.5, 6.0):
        found = 1.0 + float(compliance(np.array([x]), poisson, bonded=bonded)[0])
        # the matrix exponential loses exp(2x) of 16 digits
        assert found == pytest.approx(surface_compliance(x, poisson, bonded=bonded), rel=1e-9)


@pytest.mark.parametrize("bonded", [True, False])
def test_a_mode_far_shorter_than_the_thickness_does_not_see_the_base(bonded):
    assert abs(float(compliance(np.array([20.0]), 0.5, bonded=bonded)[0])) < 1e-13


def pressure_rings(a_over_h: float, poisson: float, rings: int) -> float:
    """kappa of a flat punch by uniform pressure rings and collocation: no integral equation, no cosines.

    A ring of radii s < t under unit pressure has the transform [t J1(kt) - s J1(ks)] / k; depth under all
    rings together must be one at the middle of each.
    """
    edges = np.sin(np.linspace(0.0, math.pi / 2.0, rings + 1))
    middle = (edges[1:] + edges[:-1]) / 2.0
    k = (np.arange(60_000) + 0.5) * 0.02
    layer = 1.0 + compliance(k / a_over_h, poisson, bonded=True)
    transform = (edges[:, None] * j1(np.outer(edges, k))) / k
    transform = np.diff(transform, axis=0)
    depth = 2.0 * (j0(np.outer(middle, k)) * layer) @ transform.T * 0.02
    pressure = np.linalg.solve(depth, np.ones(rings))
    area = math.pi * np.diff(edges**2)
    return float(pressure @ area) / 2.0


def test_factor_of_a_punch_is_that_of_rings_of_pressure():
    for a_over_h in (0.5, 1.0, 2.0):
        # 40 rings: the singular edge costs 0.4 % of the force
        assert flat_factor(a_over_h, 0.4) == pytest.approx(pressure_rings(a_over_h, 0.4, 40), rel=6e-3)


@pytest.mark.parametrize(("a_over_h", "printed"), HAYES_FLAT_HALF.items())
def test_factors_are_those_hayes_printed(a_over_h, printed):
    # the tables were computed with few terms: their last digits drift by 0.2 % towards a/h = 1
    assert flat_factor(a_over_h, 0.5) == pytest.approx(printed, rel=2.5e-3)


def test_a_thick_layer_is_a_half_space():
    assert flat_factor(0.0, 0.3) == pytest.approx(1.0, rel=1e-14)
    a, factor = layer_contact(0.1, 1e5, 0.4, radius_mm=2.0)
    assert a == pytest.approx(math.sqrt(0.2), rel=1e-5)
    assert factor == pytest.approx(4.0 / 3.0 * math.sqrt(2.0) * 0.1**1.5, rel=2e-5)
    angle = math.radians(70.0)
    a, factor = layer_contact(0.1, 1e5, 0.4, half_angle_rad=angle)
    # the kernel's first order is 2 a/h int (M - 1) dx / pi, 1e-6 here
    assert a == pytest.approx(2.0 / math.pi * 0.1 * math.tan(angle), rel=2e-5)
    assert factor == pytest.approx(2.0 / math.pi * math.tan(angle) * 0.01, rel=2e-5)


def test_first_order_of_the_layer_is_the_integral_of_its_compliance():
    # kappa = 1 - (2/pi) (a/h) int (M - 1) dx + O(a/h)^2, from the kernel at u = s = 0
    slope, _ = quad(lambda x: float(compliance(np.array([x]), 0.3, bonded=True)[0]), 0.0, 30.0)
    e = 1e-4
    assert (flat_factor(e, 0.3) - 1.0) / e == pytest.approx(-2.0 / math.pi * slope, rel=1e-3)


def test_a_thin_compressible_layer_is_squeezed_column_by_column():
    # modulus of a column that can't spread, times area over thickness: reached as h/a
    poisson, a = 0.2, MOST_A_OVER_H
    column = (1.0 - poisson) / ((1.0 + poisson) * (1.0 - 2.0 * poisson)) * (1.0 - poisson**2)
    force = column * math.pi * a**2
    assert 2.0 * a * flat_factor(a, poisson) == pytest.approx(force, rel=0.25)
    nearer = 2.0 * 3.0 * flat_factor(3.0, poisson) / (column * math.pi * 9.0)
    assert abs(2.0 * a * flat_factor(a, poisson) / force - 1.0) < abs(nearer - 1.0)


def test_too_wide_a_contact_is_refused():
    with pytest.raises(ValueError, match="outside"):
        flat_factor(7.0, 0.5)
    with pytest.raises(ValueError, match="outside"):
        layer_contact(5.0, 0.1, 0.3, radius_mm=10.0)
