"""Tissues that can be felt without a recording of one's own.

``paper-a``
    K = 63.62 N/mm and tau = 0.021 s of Sadeghnejad et al. (endoscopic sinus surgery), Table 2, with the cubic
    through the peaks of Table 1 less the branch's force; [reading], see docs/model.md.
``meat``
    One cut of meat, indented at 1.2 mm/s and held for 10 s: two branches fitted to a public recording
    (perineal_indentation, test 230403-RDG2B), rounded.  One speed: how F_s and K share the force is not
    known from it, and its tip is not stated.

Scales are those of :func:`tissueid.rendering.precheck.check_before_force` for the device that is assumed
where nothing was measured: 5 N, 0.5 N s/m, 1.5 ticks.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType

import numpy as np

from tissueid.errors import UsageError, printable
from tissueid.model.kelvin_voigt import KelvinVoigt
from tissueid.model.passivity import DEFAULT_DELAY_TICKS
from tissueid.rendering.precheck import Demands, Precheck, check_before_force
from tissueid.rendering.tissue_block import Tissue

#: A device of which nothing was measured.
ASSUMED_DEVICE = Demands(clamp_N=5.0, damping_N_s_per_m=0.5, delay_ticks=DEFAULT_DELAY_TICKS)


def _paper_a() -> Tissue:
    model = KelvinVoigt(branches=1, stiffness_degree=0, depth_mm=8.0)
    theta = model.join(np.array([47.42, -5.577, 0.3804]), np.array([[63.62]]), np.array([0.021]))
    return Tissue(model, theta, (10.0 / 60.0, 500.0 / 60.0), name="paper-a")


def _meat() -> Tissue:
    model = KelvinVoigt(branches=2, stiffness_degree=1, depth_mm=5.0)
    static = np.array([0.0960, -0.0411, 0.0084])
    stiffness = np.array([[0.0748, 0.1671], [0.0, 0.0233]])
    theta = model.join(static, stiffness, np.array([0.353, 3.978]))
    return Tissue(model, theta, (1.2, 1.2), name="meat")


#: name -> the tissue.
PRESETS: Mapping[str, Callable[[], Tissue]] = MappingProxyType({"paper-a": _paper_a, "meat": _meat})


def preset_tissue(name: str) -> Tissue:
    """The tissue of that name.

    Raises UsageError: there is none.
    """
    if name not in PRESETS:
        msg = f"there is no preset {printable(name)!r}; presets are {', '.join(PRESETS)}"
        raise UsageError(msg)
    return PRESETS[name]()


def preset_check(name: str) -> Precheck:
    """Scale and numbers of a preset on the device that is assumed where nothing was measured.

    Raises UsageError: there is none of that name.
    """
    return check_before_force(preset_tissue(name), ASSUMED_DEVICE)
