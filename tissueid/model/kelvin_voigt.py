"""Modified Kelvin-Voigt contact model with up to three relaxation branches.

    F(t) = F_s(x) + sum_j K_j(x) s_j,      tau_j ds_j/dt + s_j = tau_j dx/dt
    F_s(x) = a1 x + a2 x^2 + a3 x^3,       K_j(x) = b_j0 + b_j1 x + b_j2 x^2

K stands **outside** the convolution.  Equations (1) to (8) of Sadeghnejad et al., reconstructed from their
text; after Mahvash & Dupont, doi 10.1109/ROBOT.2009.5152617.  theta: see :mod:`tissueid.model.channels`.
"""

from __future__ import annotations

from tissueid.model.channels import ChannelModel, ElasticModel
from tissueid.model.laws.relaxation import Prony
from tissueid.model.laws.static import Polynomial
from tissueid.model.laws.stiffness import Constant, Linear, Quadratic

KEY = "kelvin-voigt"
STATIC_DEGREE, MAX_BRANCHES = 3, 3
STIFFNESS = (Constant(), Linear(), Quadratic())


def kelvin_voigt(branches: int, stiffness_degree: int, depth_mm: float) -> ChannelModel:
    """The model for 0 (elastic) to 3 branches, a degree of K of 0 to 2, and a largest depth.

    Passivity is demanded on [0, depth_mm]; beyond it F_s goes on with its end slope, K where it grows.
    """
    if not 0 <= branches <= MAX_BRANCHES:
        raise ValueError(f"{branches} branches are not offered, 0 to {MAX_BRANCHES} are")
    if not 0 <= stiffness_degree < len(STIFFNESS):
        raise ValueError(f"degree {stiffness_degree} of K is not offered, 0 to {len(STIFFNESS) - 1} are")
    if not depth_mm > 0.0:
        raise ValueError(f"depth_mm must be positive, is {depth_mm}")
    kind = ChannelModel if branches else ElasticModel
    return kind(
        static=Polynomial(STATIC_DEGREE),
        stiffness_law=STIFFNESS[stiffness_degree],
        relaxation=Prony(max(branches, 1)),
        depth_mm=depth_mm,
        # exponentials are themselves at all times
        resolution_s=0.0,
        window_s=float("inf"),
        name=KEY,
    )
