"""Parameters of a tissue, as an owner hands them to a servo."""

import numpy as np

from tissueid.rendering.options import ASSUMED_DEVICE, preset_tissue
from tissueid.rendering.passivity_control import PassivityLimits
from tissueid.rendering.precheck import Precheck, check_before_force
from tissueid.rendering.tissue_block import Plane, tissue_block

#: The controller counts, and never brakes.
WATCHING = PassivityLimits(on=False)


def preset_check(name: str) -> Precheck:
    """Scale and numbers of a preset on the device that is assumed where nothing was measured."""
    return check_before_force(preset_tissue(name), ASSUMED_DEVICE)


def parameters(tissue="paper-a", *, surface_z=0.130, scales=None, label=0, control=WATCHING) -> np.ndarray:
    """A tissue below a height [m], at scales of force and motion or at its preset's own, and a controller."""
    if scales is None:
        found = preset_check(tissue).scaling
        scales = found.force, found.motion
    felt = preset_tissue(tissue) if isinstance(tissue, str) else tissue
    surface = Plane((0.0, 0.0, surface_z))
    block = tissue_block(felt, surface, force_scale=scales[0], motion_scale=scales[1], label=label)
    return np.concatenate([block, control.block()])
