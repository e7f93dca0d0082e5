"""Interpretations of equations and numbers that the paper's text lost, each of which can be switched."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from types import MappingProxyType

from tissueid.errors import UsageError, printable

#: Reading -> choice -> what it takes the paper to say; the first choice is the default.
READINGS: Mapping[str, Mapping[str, str]] = MappingProxyType(
    {
        "stiffness": {
            "constant": "63.62 is a constant K [N/mm]",
            "linear": "63.62 is the coefficient of K(x) = 63.62 x [N/mm2]",
        },
        "relaxation": {
            "time": "0.021 is the relaxation time [s]",
            "rate": "0.021 is a relaxation rate [1/s]",
        },
        "device": {
            "mass-damping-stiffness": "the device of Table 3 is 1.158 kg, 115.4 N s/m, 31.46 N/m",
            "mass-stiffness-damping": "the device of Table 3 is 1.158 kg, 115.4 N/m, 31.46 N s/m",
        },
        "criterion": {
            "work": "the tissue ruptures at a total work",
            "weighted-force": "the tissue ruptures at a weighted force F_s + 1.5 F_d",
            "stored-energy": "the tissue ruptures at a stored energy",
            "depth": "the tissue ruptures at a depth",
        },
        "surface": {
            "hyperboloid": "the guidance surface is one sheet of a hyperboloid, the 1 under the root",
            "cone": "the guidance surface is the cone as printed",
        },
    }
)


@dataclass(frozen=True, slots=True)
class Readings:
    """One choice for every reading of :data:`READINGS`."""

    stiffness: str = "constant"
    relaxation: str = "time"
    device: str = "mass-damping-stiffness"
    criterion: str = "work"
    surface: str = "hyperboloid"

    def words(self, name: str) -> str:
        """Reading of the paper that the choice takes."""
        return READINGS[name][getattr(self, name)]

    def as_json(self) -> dict[str, dict[str, str]]:
        """Choice and words of each."""
        return {
            field.name: {"choice": getattr(self, field.name), "words": self.words(field.name)}
            for field in fields(self)
        }


def readings_from(settings: Sequence[str]) -> Readings:
    """Readings of ``--set NAME=CHOICE``.

    Raises UsageError: an unknown name or choice.
    """
    readings = Readings()
    for setting in settings:
        name, equals, choice = setting.partition("=")
        if not equals or name not in READINGS:
            msg = f"--set {printable(setting)}: give NAME=CHOICE, NAME one of {', '.join(READINGS)}"
            raise UsageError(msg)
        if choice not in READINGS[name]:
            msg = f"--set {printable(setting)}: {name} is one of {', '.join(READINGS[name])}"
            raise UsageError(msg)
        readings = replace(readings, **{name: choice})
    return readings
