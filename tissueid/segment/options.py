"""Options by which the user decides instead of the segmenter."""

from __future__ import annotations

from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import PurePath

from tissueid.trial import Trial


@dataclass(frozen=True, slots=True)
class SegmentOptions:
    """Overrides; ``None`` leaves the decision to the data.

    Attributes
    ----------
    compression_sign, force_sign : int or None
        +1 or -1, in the meaning of :class:`tissueid.trial.Segmentation`.
    contact_displacement_mm : float or None
        Displacement of contact, as recorded [mm].
    contact_sd_mm : float
        Its standard deviation [mm]; used with ``contact_displacement_mm`` only.
    minimum_hold_s : float or None
        Shortest standstill after a ramp that is a hold [s].
    start_s, end_s : float or None
        First and last time that count, as recorded [s]; what lies outside is in no phase and is not fitted.
    rupture : bool
        ``False``: no force drop is a rupture.
    hold_from_s : float or None
        Where the hold nearest to it begins, as recorded [s].
    exclude : tuple of str
        Patterns of the paths, file names, sheets or specimens that are not fitted.
    """

    compression_sign: int | None = None
    force_sign: int | None = None
    contact_displacement_mm: float | None = None
    contact_sd_mm: float = 0.0
    minimum_hold_s: float | None = None
    start_s: float | None = None
    end_s: float | None = None
    rupture: bool = True
    hold_from_s: float | None = None
    exclude: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        for name in ("compression_sign", "force_sign"):
            if getattr(self, name) not in (None, 1, -1):
                raise ValueError(f"{name} is {getattr(self, name)}, must be 1, -1 or None")
        if not self.contact_sd_mm >= 0.0:
            raise ValueError(f"contact_sd_mm is {self.contact_sd_mm}, must be >= 0")
        for name, what in (("start_s", "the window"), ("hold_from_s", "a hold")):
            start = getattr(self, name)
            if start is not None and self.end_s is not None and not start < self.end_s:
                raise ValueError(f"{name} is {start} and end_s {self.end_s}: {what} must end after it starts")

    def stated(self) -> dict[str, float | int | bool]:
        """Decisions, by the key that study.toml has for them."""
        said = {
            "compression": self.compression_sign,
            "force": self.force_sign,
            "contact_mm": self.contact_displacement_mm,
            "minimum_hold_s": self.minimum_hold_s,
            "start_s": self.start_s,
            "end_s": self.end_s,
            "hold_from_s": self.hold_from_s,
            "rupture": None if self.rupture else False,
        }
        return {key: value for key, value in said.items() if value is not None}

    def excludes(self, trial: Trial) -> str | None:
        """The first pattern that fits a recording, ``None`` where none does."""
        source = trial.source
        names = (source.path, PurePath(source.path).name, source.sheet or source.path, trial.specimen)
        return next((one for one in self.exclude if any(fnmatchcase(name, one) for name in names)), None)
