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

__all__ = ["Carried", "RenderOptions"]


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
    """Options of the user; None where nothing was said.

    Attributes
    ----------
    bundle : Path or None
    preset : str or None
    draw_specimen : str or None
        Seed of a specimen drawn from a population, or ``new``.
    draw, quantile, of
        Which tissue of the bundle's posterior.
    against, against_draw, against_quantile
        The tissue to compare with: another bundle, another draw, or both.
    device : str
    device_options : mapping
        For the device's class.
    script : str or None
    program : Carried or None
        Motion of the simulated grip, in place of a script.
    seconds : float or None
        Length of a session without a script.
    force_scale, motion_scale, tip_radius_mm : float or None
    surface : str
    environment : str or None
        Installed force law, instead of a tissue.
    scene : Scene or None
        Where the tissue or the guidance comes from.
    control : bool
        Whether the passivity controller may brake.
    blind : bool
    presentations : int or None
    pseudonym : str or None
    seed : int or None
        Of the order of a blind comparison.
    replay : Path or None
        Log whose motion is rendered again.
    virtual : bool
        As fast as it can be computed.
    bridge : bool
        Whether another program moves the session.
    led : bool
        Whether a pointer may lead the hand of the simulated device, where no script does.
    """

    bundle: Path | None = None
    preset: str | None = None
    draw: int | None = None
    draw_specimen: str | None = None
    quantile: float | None = None
    of: str = DEFAULT_FUNCTIONAL
    against: Path | None = None
    against_draw: int | None = None
    against_quantile: float | None = None
    device: str = "auto"
    device_options: Mapping[str, Any] = field(default_factory=dict)
    script: str | None = None
    program: Carried | None = None
    seconds: float | None = None
    force_scale: float | None = None
    motion_scale: float | None = None
    tip_radius_mm: float | None = None
    surface: str = "plane"
    environment: str | None = None
    scene: Scene | None = None
    control: bool = True
    blind: bool = False
    presentations: int | None = None
    pseudonym: str | None = None
    seed: int | None = None
    replay: Path | None = None
    virtual: bool = False
    bridge: bool = False
    led: bool = False
