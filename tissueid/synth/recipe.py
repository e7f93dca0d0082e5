"""A recipe: everything that decides a synthetic data set, except the random numbers; and the named ones.

::

    name = "ramp-and-hold"
    rate_Hz = 100.0
    static = [20.0, -1.2, 0.35]            # F_s = a1 x + a2 x^2 + a3 x^3  [N/mm, N/mm2, N/mm3]
    sigma_N = 1.0
    [[branches]]
    stiffness = [63.62, 10.0]              # K = k0 + k1 x  [N/mm, N/mm2]
    tau_s = 0.021
    [[logs]]
    name = "hold-4"
    repeats = 3
    moves = [{to_mm = 4.0, speed_mm_min = 250.0}, {hold_s = 30.0}]
    [rupture]                              # only where the tissue is to break
    criterion = "work"
    threshold = 150.0                      # [N mm]
    cv = 0.1

The data follow the modified Kelvin-Voigt law F = F_s(x) + sum_j K_j(x) s_j, tau_j s_j' + s_j = tau_j x'.
``paper-a-30`` has ramps at six speeds to 8 mm and holds at 2, 4, 6 and 8 mm, three of each, ``paper-a-22``
one of each hold; ``-k1`` makes K = 63.62 N/mm + 10 N/mm2 x.  Depths, speeds and hold times are those of
Sadeghnejad et al. (sinus tissue, 4 mm indenter); 63.62 and tau = 0.021 s are a reading of their Table 2, the
rest is chosen. ``rupture-18`` tells criteria of rupture apart: the fastest of three speeds a specimen gives
half of the force or more to the relaxing branch; at paper A's speeds it is 15 % at the most, and 18 tests do
not tell.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

from tissueid.errors import InputError, refuse

SECONDS_PER_MINUTE = 60.0
NONNEGATIVE = (
    "sigma_N", "ar1_sigma_N", "sigma_mm", "cv_specimen", "cv_static", "cv_both", "contact_offset_sd_mm",
    "crosshead_rounding_s", "force_filter_s",
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class Move:
    """A constant-speed move of the crosshead to ``to_mm`` of travel at ``speed_mm_min`` (> 0)."""

    to_mm: float
    speed_mm_min: float

    @property
    def speed_mm_s(self) -> float:
        """Speed [mm/s]."""
        return self.speed_mm_min / SECONDS_PER_MINUTE


@dataclass(frozen=True, slots=True)
class Hold:
    """The crosshead stands for ``hold_s`` seconds."""

    hold_s: float


@dataclass(frozen=True, slots=True)
class Branch:
    """One spring-damper branch: stiffness polynomial (k0, k1, k2) [N/mm, N/mm2, N/mm3] and tau [s]."""

    stiffness: tuple[float, ...]
    tau_s: float


#: What a threshold of rupture may be of.
RUPTURES = ("work", "weighted-force", "stored-energy", "depth")


@dataclass(frozen=True, slots=True)
class Rupture:
    """The tissue breaks when a measure of its loading first reaches a threshold."""

    #: ``work`` [N mm], ``weighted-force`` F_s + w F_d [N], ``stored-energy`` [N mm] or ``depth`` [mm].
    criterion: str
    threshold: float  # median
    #: Coefficient of variation of log-normal factors (median 1) of each test and of each specimen.
    cv: float = 0.0
    cv_specimen: float = 0.0
    weight: float = 1.5  # w of the weighted force
    residual: float = 0.2  # share of the force that is left

    def __post_init__(self) -> None:
        if self.criterion not in RUPTURES:
            msg = f"rupture: criterion is {self.criterion!r}, must be one of {', '.join(RUPTURES)}"
            raise ValueError(msg)
        if not (self.threshold > 0.0 and min(self.cv, self.cv_specimen, self.weight) >= 0.0):
            raise ValueError(f"rupture: threshold must be > 0 and cv, cv_specimen, weight >= 0, is {self}")
        if not 0.0 <= self.residual <= 1.0:
            raise ValueError(f"rupture: residual is {self.residual}, must lie within 0 to 1")


@dataclass(frozen=True, slots=True)
class Log:
    """One recording: what the crosshead does from travel 0, and how often it is repeated."""

    name: str
    moves: tuple[Move | Hold, ...]
    repeats: int = 1


@dataclass(frozen=True, slots=True)
class Recipe:
    """A synthetic data set."""

    name: str
    logs: tuple[Log, ...]  # the protocol; every log of one specimen, all first repeats before all second ones
    rate_Hz: float = 1000.0  # sampling rate
    static: tuple[float, ...] = (20.0, -1.2, 0.35)  # a1, a2, a3 of the static force [N/mm, N/mm2, N/mm3]
    branches: tuple[Branch, ...] = (Branch((63.62,), 0.021),)
    sigma_N: float = 1.0  # standard deviation of the white force noise [N]
    #: Standard deviation [N] and lag-one correlation of a further, correlated force noise.
    ar1_sigma_N: float = 0.0
    ar1_phi: float = 0.0
    sigma_mm: float = 0.0  # standard deviation of white noise on the logged displacement [mm]
    #: Specimen label; ``-01``, ``-02``... is appended where there are several.
    specimen: str = "synthetic"
    specimens: int = 1  # number of specimens, each with the whole protocol
    cv_specimen: float = 0.0  # coefficient of variation of a log-normal gain (median 1) of a whole specimen
    #: Coefficient of variation of a log-normal gain (median 1) of each log, on the static force only and on
    #: static force and branches together.
    cv_static: float = 0.0
    cv_both: float = 0.0
    #: Standard deviation of the travel at which the tool meets the tissue [mm].  Positive draws start in air,
    #: negative ones preloaded: indented by as much, and relaxed, at t = 0.
    contact_offset_sd_mm: float = 0.0
    contact_offset_mm: float = 0.0  # mean of that travel [mm]
    #: Time the crosshead takes to slow down to a stop [s]; centred on the nominal corner, so that the stop
    #: lies exactly at the nominal travel.  The measured displacement is what is logged.
    crosshead_rounding_s: float = 0.0
    force_filter_s: float = 0.0  # time constant of a first-order low-pass in the load channel [s]
    compression_sign: int = 1  # sign of the recorded displacement and force under compression
    decimals: tuple[int, int, int] = (5, 5, 5)  # printed decimals of time, displacement and force
    rupture: Rupture | None = None  # where the tissue breaks in the first loading

    def __post_init__(self) -> None:
        problem = _problem(self)
        if problem is not None:
            raise ValueError(problem)


def _problem(recipe: Recipe) -> str | None:
    """Fault of a recipe, or ``None``."""
    for name in NONNEGATIVE:
        if not getattr(recipe, name) >= 0.0:
            return f"{name} is {getattr(recipe, name)}, must be >= 0"
    checks = (
        (recipe.rate_Hz > 0.0, f"rate_Hz is {recipe.rate_Hz}, must be > 0"),
        (abs(recipe.ar1_phi) < 1.0, f"ar1_phi is {recipe.ar1_phi}, must lie between -1 and 1"),
        (
            recipe.compression_sign in (1, -1),
            f"compression_sign is {recipe.compression_sign}, must be 1 or -1",
        ),
        (recipe.specimens >= 1, f"specimens is {recipe.specimens}, must be >= 1"),
        (len(recipe.logs) >= 1, "a recipe needs at least one log"),
        (len({one.name for one in recipe.logs}) == len(recipe.logs), "two logs have one name, and one file"),
        (all(b.tau_s > 0.0 for b in recipe.branches), "tau_s must be > 0 in every branch"),
        (all(d >= 0 for d in recipe.decimals), f"decimals are {recipe.decimals}, must be >= 0"),
    )
    for holds, message in checks:
        if not holds:
            return message
    for log in recipe.logs:
        if log.repeats < 1 or not log.moves:
            return f"log {log.name!r} needs at least one move and one repeat"
        for move in log.moves:
            amount = move.speed_mm_min if isinstance(move, Move) else move.hold_s
            if not amount > 0.0:
                return f"log {log.name!r}: {move} must have a speed or duration > 0"
    return None


def load_recipe(path: str | Path) -> Recipe:
    """Read a recipe from a TOML file."""
    try:
        return _from_table(tomllib.loads(Path(path).read_text(encoding="utf-8")))
    except OSError as error:
        message = f"can't be read ({error.strerror}); give a recipe file or a built-in name"
        raise InputError(code="unreadable", message=message, path=str(path)) from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise InputError(code="recipe", message=f"is not TOML: {error}", path=str(path)) from error
    except (ValueError, TypeError, KeyError) as error:
        raise InputError(code="recipe", message=f"is not a recipe: {error}", path=str(path)) from error


def _from_table(table: Mapping[str, Any]) -> Recipe:
    """A recipe from the tables of its TOML file."""
    known = {field.name for field in fields(Recipe)}
    unknown = sorted(set(table) - known)
    if unknown:
        raise ValueError(f"unknown key {unknown[0]!r}; known are {', '.join(sorted(known))}")
    values = dict(table)
    values["logs"] = tuple(
        Log(
            entry["name"],
            tuple(Hold(**move) if "hold_s" in move else Move(**move) for move in entry["moves"]),
            int(entry.get("repeats", 1)),
        )
        for entry in table["logs"]
    )
    if "branches" in table:
        values["branches"] = tuple(
            Branch(tuple(float(k) for k in entry["stiffness"]), float(entry["tau_s"]))
            for entry in table["branches"]
        )
    if "static" in table:
        values["static"] = tuple(float(a) for a in table["static"])
    if "decimals" in table:
        time, displacement, force = table["decimals"]
        values["decimals"] = (int(time), int(displacement), int(force))
    if "rupture" in table:
        values["rupture"] = Rupture(**table["rupture"])
    return Recipe(**values)


def dump_recipe(recipe: Recipe) -> str:
    """The TOML text of a recipe; :func:`load_recipe` reads it back equal."""
    tables = ("branches", "logs", "rupture")
    lines = [
        f"{field.name} = {_toml(getattr(recipe, field.name))}"
        for field in fields(Recipe)
        if field.name not in tables
    ]
    if not recipe.branches:
        lines.append("branches = []")
    for branch in recipe.branches:
        lines += ["", "[[branches]]", *(f"{key} = {_toml(value)}" for key, value in asdict(branch).items())]
    if recipe.rupture is not None:
        rupture = asdict(recipe.rupture)
        lines += ["", "[rupture]", *(f"{key} = {_toml(value)}" for key, value in rupture.items())]
    for log in recipe.logs:
        moves = ", ".join(
            "{" + ", ".join(f"{key} = {_toml(value)}" for key, value in asdict(move).items()) + "}"
            for move in log.moves
        )
        lines += [
            "",
            "[[logs]]",
            f"name = {_toml(log.name)}",
            f"repeats = {log.repeats}",
            f"moves = [{moves}]",
        ]
    return "\n".join(lines) + "\n"


def _toml(value: Any) -> str:
    """A scalar or a list of scalars in TOML."""
    from tomlkit import item

    return str(item(value).as_string())


SPEEDS_MM_MIN = (10.0, 70.0, 100.0, 150.0, 250.0, 500.0)
DEPTHS_MM = (2.0, 4.0, 6.0, 8.0)
HOLD_SPEED_MM_MIN = 250.0
HOLD_S = 30.0
RAMP_DEPTH_MM = 8.0
TAU_S = 0.021
#: Ramps to rupture: they begin 1 mm above a tissue that hardens, whose tangent exceeds its secant.
RUPTURE_SPEEDS_MM_MIN = (120.0, 600.0, 3000.0)
RUPTURE_TRAVEL_MM = 10.0
HARDENING_STATIC = (6.0, 0.0, 0.4)
RUPTURE_WORK_N_MM = 200.0
CONSTANT_STIFFNESS = (63.62,)
GROWING_STIFFNESS = (63.62, 10.0)


def _ramps(repeats: int) -> tuple[Log, ...]:
    return tuple(
        Log(f"ramp-{speed:03.0f}", (Move(RAMP_DEPTH_MM, speed),), repeats=repeats) for speed in SPEEDS_MM_MIN
    )


def _holds(repeats: int) -> tuple[Log, ...]:
    return tuple(
        Log(f"hold-{depth:.0f}", (Move(depth, HOLD_SPEED_MM_MIN), Hold(HOLD_S)), repeats=repeats)
        for depth in DEPTHS_MM
    )


def _to_rupture() -> Recipe:
    return Recipe(
        "rupture-18",
        tuple(
            Log(f"rupture-{speed:04.0f}", (Move(RUPTURE_TRAVEL_MM, speed),))
            for speed in RUPTURE_SPEEDS_MM_MIN
        ),
        rate_Hz=250.0,
        static=HARDENING_STATIC,
        branches=(Branch(CONSTANT_STIFFNESS, TAU_S),),
        sigma_N=0.2,
        specimen="rupture",
        specimens=6,
        cv_specimen=0.15,
        contact_offset_mm=1.0,
        contact_offset_sd_mm=0.1,
        decimals=(3, 4, 3),
        rupture=Rupture("work", RUPTURE_WORK_N_MM, cv=0.1, cv_specimen=0.15),
    )


def _named() -> dict[str, Recipe]:
    thirty = Recipe(
        "paper-a-30", _ramps(3) + _holds(3), specimen="paper-a", branches=(Branch(CONSTANT_STIFFNESS, TAU_S),)
    )
    twenty_two = replace(thirty, name="paper-a-22", logs=_ramps(3) + _holds(1))
    growing = (Branch(GROWING_STIFFNESS, TAU_S),)
    recipes = [
        thirty,
        twenty_two,
        replace(thirty, name="paper-a-30-k1", branches=growing),
        replace(twenty_two, name="paper-a-22-k1", branches=growing),
        # small enough to live in the repository
        replace(twenty_two, name="paper-a-22-250Hz", rate_Hz=250.0, decimals=(3, 5, 4)),
        replace(thirty, name="paper-a-30-10Hz", rate_Hz=10.0, decimals=(3, 5, 4)),
        replace(thirty, name="paper-a-hold-100Hz", rate_Hz=100.0, logs=_holds(1)[-1:], decimals=(3, 5, 4)),
        _to_rupture(),
    ]
    return {entry.name: entry for entry in recipes}


#: Built-in recipes by name.
RECIPES: Mapping[str, Recipe] = MappingProxyType(_named())


def recipe(name: str) -> Recipe:
    """The built-in recipe of that name."""
    if name not in RECIPES:
        refuse(f"no built-in recipe {name!r}; there are {', '.join(sorted(RECIPES))}, or give a recipe.toml")
    return RECIPES[name]
