"""Contents of a study file: specimens, protocols, calibration, and what the user decided and why.

Frozen data without files or units to convert: :mod:`tissueid.ingest.manifest` makes a :class:`Study` from
``study.toml``, and the pipeline asks it, trial by trial, what was said (:meth:`Study.decision`).  Where
several tables name one recording the later ones win, key by key: a glob first, exceptions below it.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from collections.abc import Set as AbstractSet
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Any

from tissueid.arrays import FloatArray
from tissueid.notebook import Shown
from tissueid.priors import PopulationPriors, Priors
from tissueid.trial import Protocol, frozen_array

#: Table of a study.toml, units in the names of its keys
TomlTable = Mapping[str, Any]


@dataclass(frozen=True, slots=True, eq=False)
class FrameCurve:
    """Deflection of machine, load cell and fixture under a compressive force.

    The compliance du/dF is linear between knots, so that the deflection u is smooth, monotone and
    linear in the knot values; see :mod:`tissueid.model.frame`.
    """

    force_N: FloatArray  # (k,), knots, growing from 0
    compliance_mm_per_N: FloatArray  # (k,), du/dF at the knots, >= 0
    covariance: FloatArray  # (k, k), of the compliances [mm2/N2]
    #: Forces that were calibrated; ``None`` for a stated stiffness, which is taken for all.
    range_N: tuple[float, float] | None = None
    #: The file it was read from.
    path: str | None = None
    sha256: str | None = None
    sources: tuple[str, ...] = ()  # hashes of the recordings behind it

    def __post_init__(self) -> None:
        for name in ("force_N", "compliance_mm_per_N", "covariance"):
            object.__setattr__(self, name, frozen_array(getattr(self, name)))


@dataclass(frozen=True, slots=True)
class Calibration:
    """Stated calibration of the channels."""

    #: Keys of ``[calibration]`` in study.toml, units in their names.
    values: TomlTable = field(default_factory=dict)
    frame: FrameCurve | None = None  # deflection of the frame; ``None`` where nothing is known of it

    def __post_init__(self) -> None:
        object.__setattr__(self, "values", MappingProxyType(dict(self.values)))

    @property
    def verified_from_N(self) -> float | None:
        """Lower limit of the load cell's verified range [N], as stated."""
        value = self.values.get("verified_from_N")
        return None if value is None else float(value)


@dataclass(frozen=True, slots=True)
class Entry:
    """One ``[[trial]]``, ``[[override]]`` or ``[[exclude]]`` table."""

    values: TomlTable  # its keys, units in their names
    files: tuple[str, ...]  # absolute paths of the recordings that its ``file`` names
    line: int  # line of study.toml at which the table begins

    def __post_init__(self) -> None:
        object.__setattr__(self, "values", MappingProxyType(dict(self.values)))

    @property
    def sheet(self) -> str | None:
        """The one sheet it speaks of, ``None`` for all."""
        value = self.values.get("sheet")
        return None if value is None else str(value)

    def names(self, path: str, sheet: str | None) -> bool:
        """True where it speaks of this recording (an absolute path)."""
        return path in self.files and self.sheet in (None, sheet)


@dataclass(frozen=True, slots=True)
class Decision:
    """Everything the study says of one recording."""

    listed: bool  # named under ``[[trial]]``
    trial: TomlTable  # keys of its ``[[trial]]`` tables
    protocol: TomlTable  # keys of its ``[[protocol]]``
    override: TomlTable  # what the user decided; ``because`` gathers the reasons
    excluded: str | None  # why it is not fitted


def _merged(entries: Iterable[Entry]) -> dict[str, Any]:
    """Later tables win, key by key; maps are merged, reasons are gathered."""
    merged: dict[str, Any] = {}
    for entry in entries:
        for key, value in entry.values.items():
            known = merged.get(key)
            if isinstance(value, Mapping) and isinstance(known, Mapping):
                merged[key] = {**known, **value}
            elif key == "because" and known is not None:
                merged[key] = known if value in known.split("; ") else f"{known}; {value}"
            elif key not in {"file", "sheet"}:
                merged[key] = value
    return merged


@dataclass(frozen=True, slots=True)
class Study(Shown):
    """A study file.

    Attributes
    ----------
    path : str
        The file as it was named.
    sha256 : str
        Of its bytes.
    about : mapping
        ``[study]``.
    tip : mapping
        ``[tip]``.
    calibration : Calibration
    priors : Priors
        ``[priors]``; defaults where nothing is stated.
    model : str or None
        Name of ``[model]``, or its candidates with ``|`` between them.
    population : PopulationPriors or None
        ``[population]``; ``None`` where nothing is stated.
    specimens : mapping
        Name -> its ``[[specimen]]`` table.
    protocols : mapping
        Name -> its ``[[protocol]]`` table.
    trials, overrides, exclusions : tuple of Entry
    """

    path: str
    sha256: str = ""
    about: TomlTable = field(default_factory=dict)
    tip: TomlTable = field(default_factory=dict)
    calibration: Calibration = field(default_factory=Calibration)
    priors: Priors = field(default_factory=Priors)
    model: str | None = None
    population: PopulationPriors | None = None
    specimens: Mapping[str, TomlTable] = field(default_factory=dict)
    protocols: Mapping[str, TomlTable] = field(default_factory=dict)
    trials: tuple[Entry, ...] = ()
    overrides: tuple[Entry, ...] = ()
    exclusions: tuple[Entry, ...] = ()

    def __post_init__(self) -> None:
        for name in ("about", "tip", "specimens", "protocols"):
            object.__setattr__(self, name, MappingProxyType(dict(getattr(self, name))))

    @property
    def only_listed(self) -> bool:
        """True where recordings that are not named take no part."""
        return bool(self.about.get("only_listed", False))

    @property
    def entries(self) -> tuple[Entry, ...]:
        """Every table that names recordings."""
        return (*self.trials, *self.overrides, *self.exclusions)

    @staticmethod
    def real_path(path: str) -> str:
        """The path that :attr:`Entry.files` would hold."""
        return os.path.realpath(path)

    def of_sheets(self, picked: Mapping[str, AbstractSet[str]]) -> Study:
        """Drop tables that speak of other sheets than those picked.

        ``picked``: real path of a file -> names of the sheets that are read of it.
        """

        def asked(entry: Entry) -> bool:
            one = entry.sheet
            return (
                one is None or not entry.files or any(one in picked.get(name, {one}) for name in entry.files)
            )

        return replace(
            self,
            trials=tuple(filter(asked, self.trials)),
            overrides=tuple(filter(asked, self.overrides)),
            exclusions=tuple(filter(asked, self.exclusions)),
        )

    def decision(self, path: str, sheet: str | None) -> Decision:
        """Decision of the study on one recording.

        ``path``: as in :class:`tissueid.trial.Source`; links are followed before paths are compared.
        """
        real = self.real_path(path)
        trials = [entry for entry in self.trials if entry.names(real, sheet)]
        trial = _merged(trials)
        excluded = [entry for entry in self.exclusions if entry.names(real, sheet)]
        return Decision(
            listed=bool(trials),
            trial=trial,
            protocol=self.protocols.get(trial.get("protocol", ""), {}),
            override=_merged(entry for entry in self.overrides if entry.names(real, sheet)),
            excluded=_merged(excluded)["because"] if excluded else None,
        )

    def protocol(self, decision: Decision, stated: Protocol) -> Protocol:
        """Protocol that the file states, filled from the study where the file is silent."""
        said = decision.protocol
        return replace(
            stated,
            kind=stated.kind or said.get("kind"),
            speed_mm_s=stated.speed_mm_s or said.get("speed_mm_s"),
            depth_mm=stated.depth_mm or said.get("depth_mm"),
            hold_s=stated.hold_s if stated.hold_s is not None else said.get("hold_s"),
            tip_radius_mm=stated.tip_radius_mm or self.tip.get("radius_mm"),
        )
