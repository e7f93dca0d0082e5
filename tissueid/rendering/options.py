"""Options of a session, as frozen data."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from tissueid.haptics.hand import Hand
from tissueid.rendering.choice import DEFAULT_FUNCTIONAL
from tissueid.rendering.scene import Scene


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
    seconds: float | None = None  # length of a session without a script
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
