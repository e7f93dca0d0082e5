"""Options of ``fit`` that decide which numbers are quoted beside the model's parameters."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import click

from tissueid.cli.flags import Flags, option
from tissueid.errors import UsageError

if TYPE_CHECKING:
    from tissueid.measured.geometry import Geometry


class QuotingFlags(Flags):
    """Flags that say which numbers are quoted beside those of the model."""

    # fmt: off
    unloading: bool = option("Fit retracts and cycles as well, with the law of contact loss.")
    frequencies: str | None = option(
        "Frequencies [Hz] of storage and loss stiffness, as 0.1,1,10. [default: those the data support]",
        metavar="LIST",
    )
    depths: str | None = option("Depths [mm] at which each loop's stiffness is given.", metavar="LIST")
    tip: str | None = option(
        "Tip, for moduli: sphere:RADIUS, flat:RADIUS [mm] or cone:HALF-ANGLE [degrees].", metavar="SHAPE:SIZE"
    )
    thickness: float | None = option("Thickness of the layer under --tip.", metavar="MM")
    poisson: float = option(
        "Poisson's ratio behind the moduli.", type=click.FloatRange(0.0, 0.5), default=0.5
    )
    # fmt: on


def _numbers(text: str | None, option: str) -> tuple[float, ...]:
    """A list of positive numbers as typed."""
    if text is None:
        return ()
    try:
        values = tuple(float(part) for part in text.split(","))
    except ValueError:
        values = ()
    if not values or not all(0.0 < value < float("inf") for value in values):
        msg = f"{option} takes positive numbers with commas between, as 0.1,1,10; got {text!r}"
        raise UsageError(msg)
    return values


def _geometry(flags: QuotingFlags) -> Geometry | None:
    """Tip and thickness as typed."""
    from tissueid.measured.geometry import Geometry
    from tissueid.model.moduli import Indenter

    if flags.tip is None:
        if flags.thickness is not None:
            msg = "--thickness needs --tip; a study.toml may hold both, a thickness for each specimen"
            raise UsageError(msg)
        return None
    shape, _, size = flags.tip.partition(":")
    try:
        number = float(size)
        tip = Indenter(shape, half_angle_deg=number) if shape == "cone" else Indenter(shape, number)
        return Geometry(tip, flags.thickness, flags.poisson)
    except ValueError as error:
        msg = f"--tip {flags.tip}: {error}; write sphere:3 or flat:2 (radius in mm), or cone:45 (degrees)"
        raise UsageError(msg) from error


def quoting_values(flags: QuotingFlags) -> dict[str, Any]:
    """The fields of ``FitOptions`` that these options fill.

    Raises UsageError: a list or a tip that can't be understood.
    """
    return {
        "unloading": flags.unloading,
        "frequencies_Hz": _numbers(flags.frequencies, "--frequencies"),
        "depths_mm": _numbers(flags.depths, "--depths"),
        "geometry": _geometry(flags),
        "poisson": flags.poisson,
    }
