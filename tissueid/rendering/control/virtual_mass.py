"""The smallest virtual mass that a sampled force sensor allows.

The force of the hand holds the hand's own inertia, and the acceleration of the virtual tool is that force
over the virtual mass: it goes round once a sample.  With M of device and hand, Mh of the hand and M^ of the
estimates one turn multiplies it by ::

    variant A   Mh M^-1 M^ / Mt             one axis, M^ = M: Mt > Mh
    variant B   Mh M^-1 (M^ / Mt - I)       one axis, M^ = Md: Mt > Md Mh / (Md + 2 Mh)

and the loop needs all eigenvalues of that within the unit circle.  Derived, and necessary only: 1.5 times the
bound is asked for by :data:`MARGIN`.
"""

from __future__ import annotations

import numpy as np

from tissueid.arrays import FloatArray
from tissueid.errors import UsageError
from tissueid.rendering.control.settings import ControlSettings

#: Virtual mass over its bound that a loop should have.
MARGIN = 1.5
HALVINGS = 60


def _turn(
    variant: str, inertias: tuple[FloatArray, FloatArray], virtual_mass_kg: float, estimate: float
) -> float:
    device, hand = inertias
    share = np.linalg.solve(device + hand, hand).T
    if variant == "A":
        turn = share @ (device + hand) * (estimate / virtual_mass_kg)
    else:
        turn = share @ (estimate * device / virtual_mass_kg - np.eye(len(device)))
    return float(np.abs(np.linalg.eigvals(turn)).max())


def turn_multiplier(settings: ControlSettings, virtual_mass_kg: float, *, estimate: float = 1.0) -> float:
    """Factor by which one turn of the loop through the force sensor grows: below 1 it dies out.

    ``estimate``: estimated inertia over the true one of what is estimated.  Returns largest magnitude of an
    eigenvalue.
    """
    return _turn(settings.variant, settings.inertias(), virtual_mass_kg, estimate)


def virtual_mass_bound(settings: ControlSettings, *, estimate: float = 1.0) -> float:
    """Virtual mass [kg] at which that factor is 1; 0 for a hand without mass.

    ``estimate``: as in :func:`turn_multiplier`.
    """
    inertias = settings.inertias()
    device, hand = inertias
    if not np.any(hand):
        return 0.0
    low, high = 0.0, estimate * float(np.linalg.eigvalsh(device + hand)[-1])
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        if _turn(settings.variant, inertias, middle, estimate) < 1.0:
            high = middle
        else:
            low = middle
    return high


def check_virtual_mass(settings: ControlSettings) -> float:
    """The bound [kg], or a refusal.

    Raises UsageError: the virtual mass lies at or below it and the loop is sampled.
    """
    bound = virtual_mass_bound(settings)
    if settings.continuous_step_s is None and not settings.unchecked and settings.tool.mass_kg <= bound:
        hand = float(np.linalg.eigvalsh(settings.operator.mass_kg)[-1])
        msg = (
            f"a virtual mass of {settings.tool.mass_kg:.3g} kg is unstable: the sampled force feeds the "
            f"inertia of the hand ({hand:.3g} kg) back, which variant {settings.variant} bears from "
            f"{bound:.3g} kg on; take {MARGIN * bound:.3g} kg or more (--virtual-mass)"
        )
        if settings.variant == "A":
            msg += ", or variant B"
        raise UsageError(msg)
    return bound
