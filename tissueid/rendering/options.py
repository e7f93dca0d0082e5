"""Options of a session, as frozen data, and tissues that can be felt without a recording."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from tissueid.errors import UsageError, printable
from tissueid.haptics.hand import Hand
from tissueid.model.kelvin_voigt import kelvin_voigt
from tissueid.model.passivity import DEFAULT_DELAY_TICKS
from tissueid.rendering.choice import DEFAULT_FUNCTIONAL
from tissueid.rendering.precheck import Demands
from tissueid.rendering.scene import Scene
from tissueid.rendering.tissue_block import Tissue


class Carried(Protocol):
    """Motion of a carried grip, in tissue units."""

    @property
    def duration_s(self) -> float:
        """Time of its end [s]."""
        ...

    def hand(
        self, *, motion_scale: float, surface_m: NDArray[np.float64], inward: NDArray[np.float64]
    ) -> Hand:
        """The machine that carries the grip along it."""
        ...


@dataclass(frozen=True, slots=True, kw_only=True)
class RenderOptions:
    """Options of the user; None where nothing was said."""

    bundle: Path | None = None
    preset: str | None = None
    #: Which tissue of the bundle's posterior.
    draw: int | None = None
    draw_specimen: str | None = None  # seed of a specimen drawn from a population, or ``new``
    quantile: float | None = None
    of: str = DEFAULT_FUNCTIONAL
    #: The tissue to compare with: another bundle, another draw, or both.
    against: Path | None = None
    against_draw: int | None = None
    against_quantile: float | None = None
    device: str = "auto"
    device_options: Mapping[str, Any] = field(default_factory=dict)  # for the device's class
    script: str | None = None
    program: Carried | None = None  # motion of the simulated grip, in place of a script
    seconds: float | None = None  # length of a session, the longest of a script
    force_scale: float | None = None
    motion_scale: float | None = None
    tip_radius_mm: float | None = None
    surface: str = "plane"
    environment: str | None = None  # installed force law, instead of a tissue
    scene: Scene | None = None  # where the tissue or the guidance comes from
    control: bool = True  # whether the passivity controller may brake
    blind: bool = False
    presentations: int | None = None
    pseudonym: str | None = None
    seed: int | None = None  # of the order of a blind comparison
    replay: Path | None = None  # log whose motion is rendered again
    virtual: bool = False  # as fast as it can be computed
    bridge: bool = False  # whether another program moves the session
    led: bool = False  # whether a pointer may lead the hand of the simulated device, where no script does


#: A device of which nothing was measured.
ASSUMED_DEVICE = Demands(clamp_N=5.0, damping_N_s_per_m=0.5, delay_ticks=DEFAULT_DELAY_TICKS)


def _paper_a() -> Tissue:
    model = kelvin_voigt(branches=1, stiffness_degree=0, depth_mm=8.0)
    theta = model.join(np.array([47.42, -5.577, 0.3804]), np.array([[63.62]]), np.array([0.021]))
    return Tissue(model, theta, (10.0 / 60.0, 500.0 / 60.0), name="paper-a")


def _meat() -> Tissue:
    model = kelvin_voigt(branches=2, stiffness_degree=1, depth_mm=5.0)
    static = np.array([0.0960, -0.0411, 0.0084])
    stiffness = np.array([[0.0748, 0.1671], [0.0, 0.0233]])
    theta = model.join(static, stiffness, np.array([0.353, 3.978]))
    return Tissue(model, theta, (1.2, 1.2), name="meat")


#: name -> the tissue.
PRESETS: Mapping[str, Callable[[], Tissue]] = MappingProxyType({"paper-a": _paper_a, "meat": _meat})


def preset_tissue(name: str) -> Tissue:
    """The tissue of that name; UsageError where there is none."""
    if name not in PRESETS:
        msg = f"there is no preset {printable(name)!r}; presets are {', '.join(PRESETS)}"
        raise UsageError(msg)
    return PRESETS[name]()
