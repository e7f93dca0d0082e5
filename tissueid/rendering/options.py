"""Options of a session, as frozen data, and the tissue that they name: a preset, or one of a posterior.

A quantile is that of a force at a depth and a speed, and the nearest draw is rendered.  Just noticeable: 7 %
of a force from 2.5 to 10 N (Pang, Tan & Durlach, Percept Psychophys 49:531, 1991), of 0.5 N at least.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any, Protocol

import numpy as np

from tissueid.arrays import FloatArray
from tissueid.errors import printable, refuse
from tissueid.haptics.hand import NUMBER, S_PER_MIN, SPEED, Hand
from tissueid.model.channels import ChannelModel, loading_force
from tissueid.model.kelvin_voigt import kelvin_voigt
from tissueid.model.passivity import DEFAULT_DELAY_TICKS
from tissueid.rendering.precheck import Demands
from tissueid.rendering.scene import Scene
from tissueid.rendering.tissue_block import Tissue
from tissueid.store.bundle import Bundle

#: The force that ``--quantile`` is of where nothing was said.
DEFAULT_FUNCTIONAL = "force at 6 mm, 250 mm/min"
#: What ``--draw-specimen`` means without a number.
NEW_SPECIMEN = "new"


class Carried(Protocol):
    """Motion of a carried grip, in tissue units."""

    @property
    def duration_s(self) -> float:
        """Time of its end [s]."""
        ...

    def hand(self, *, motion_scale: float, surface_m: FloatArray, inward: FloatArray) -> Hand:
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
        refuse(f"there is no preset {printable(name)!r}; presets are {', '.join(PRESETS)}")
    return PRESETS[name]()


#: Just-noticeable difference of force, as a share of it.
WEBER_SHARE = 0.07
#: Force below which the difference that is noticed no longer shrinks [N].
WEBER_FROM_N = 0.5

_FUNCTIONAL = re.compile(rf"force\s+at\s+{NUMBER}\s*mm\s*,\s*{SPEED}")


@dataclass(frozen=True, slots=True)
class Functional:
    """The force at a depth that was reached at one speed from rest."""

    depth_mm: float
    speed_mm_s: float

    def __str__(self) -> str:
        return f"force at {self.depth_mm:g} mm, {self.speed_mm_s * S_PER_MIN:g} mm/min"

    def of(self, model: ChannelModel, theta: FloatArray) -> float:
        """Its value for one tissue [N]."""
        depth = np.array([self.depth_mm])
        return float(loading_force(model, theta, depth, speed_mm_s=self.speed_mm_s)[0])


@dataclass(frozen=True, slots=True, eq=False)
class Picked:
    """A tissue, and how it was chosen."""

    tissue: Tissue
    draw: int | None  # row of the posterior; None for theta, the one coherent vector
    why: str  # one sentence


def parse_functional(text: str) -> Functional:
    """Read what ``--of`` says; UsageError for anything else, or no depth or speed."""
    found = _FUNCTIONAL.fullmatch(" ".join(text.split()))
    if found is None:
        refuse(f"--of {printable(text)!r} is not understood; write e.g. {DEFAULT_FUNCTIONAL!r}")
    depth, speed = float(found[1]), float(found[2])
    if not (depth > 0.0 and speed > 0.0):
        refuse(f"--of {printable(text)!r}: depth and speed must be above 0")
    return Functional(depth, speed / (S_PER_MIN if found[3] == "min" else 1.0))


def as_tissue(bundle: Bundle, theta: FloatArray | None = None) -> Tissue:
    """Tissue of a bundle, fitted or a draw; BundleError where it is normalised, or has no such model."""
    bundle.require_renderable()
    model = bundle.contact_model()
    return Tissue(
        model=model,
        theta=bundle.theta if theta is None else theta,
        speeds_mm_s=bundle.speeds_mm_s,
        tip_radius_mm=bundle.tip_radius_mm,
        tip=bundle.tip,
        name=bundle.specimen,
        rupture=bundle.rupture,
    )


def pick_draw(bundle: Bundle, number: int) -> Picked:
    """Posterior draw by its number, counted from 0; UsageError where there is none."""
    draws = _draws(bundle, "--draw")
    if not 0 <= number < len(draws):
        refuse(f"--draw {number}: the bundle has draws 0 to {len(draws) - 1}")
    return Picked(as_tissue(bundle, draws[number]), number, f"posterior draw {number} of {len(draws)}")


def pick_specimen(bundle: Bundle, seed: str) -> Picked:
    """One specimen drawn from a population's bundle, by a seed or :data:`NEW_SPECIMEN`; else UsageError."""
    if not bundle.is_population:
        refuse(
            f"--draw-specimen: the bundle of {bundle.specimen} holds one specimen; `tissueid cohort OUT` "
            "writes population.h5, and --draw chooses among what is known of one"
        )
    draws = _draws(bundle, "--draw-specimen")
    if seed != NEW_SPECIMEN and not (seed.isascii() and seed.isdigit()):
        refuse(f"--draw-specimen {printable(seed)!r}: the seed is a whole number, or nothing for a new one")
    known = int(np.random.SeedSequence().generate_state(1)[0]) if seed == NEW_SPECIMEN else int(seed)
    number = int(np.random.default_rng(known).integers(len(draws)))
    why = f"specimen {number} of {len(draws)} drawn from the {bundle.specimen} (--draw-specimen {known})"
    return Picked(as_tissue(bundle, draws[number]), number, why)


def pick_quantile(bundle: Bundle, quantile: float, functional: Functional) -> Picked:
    """The draw whose functional is nearest to its quantile; UsageError beyond the identified depth."""
    if not 0.0 <= quantile <= 1.0:
        refuse(f"--quantile is {quantile:g}, must lie within 0 and 1")
    if functional.depth_mm > bundle.depth_mm:
        refuse(f"--of {str(functional)!r} is deeper than the {bundle.depth_mm:.3g} mm that were identified")
    draws = _draws(bundle, "--quantile")
    fitted = as_tissue(bundle)
    values = np.array([functional.of(fitted.model, draw) for draw in draws])
    wanted = float(np.quantile(values, quantile))
    nearest = int(np.abs(values - wanted).argmin())
    why = (
        f"posterior draw {nearest}: {functional} is {values[nearest]:.4g} N, the {quantile:g} quantile "
        f"{wanted:.4g} N (median {np.median(values):.4g} N)"
    )
    return Picked(as_tissue(bundle, draws[nearest]), nearest, why)


def noticeable_ratio(
    one: Tissue, other: Tissue, functional: Functional, *, force_scale: float
) -> tuple[float, float, float]:
    """Forces of two tissues at the device [N], and their difference over the just-noticeable one."""
    a = functional.of(one.model, one.theta) * force_scale
    b = functional.of(other.model, other.theta) * force_scale
    noticeable = WEBER_SHARE * max(0.5 * (a + b), WEBER_FROM_N)
    return a, b, abs(a - b) / noticeable


def _draws(bundle: Bundle, option: str) -> FloatArray:
    if bundle.draws is None or not len(bundle.draws):
        refuse(f"{option}: the bundle of {bundle.specimen} holds no posterior draws; fit it with a sampler")
    return bundle.draws
