"""What the user may decide instead of the segmenter."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["SegmentOptions"]


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
    """

    compression_sign: int | None = None
    force_sign: int | None = None
    contact_displacement_mm: float | None = None
    contact_sd_mm: float = 0.0
    minimum_hold_s: float | None = None

    def __post_init__(self) -> None:
        for name in ("compression_sign", "force_sign"):
            if getattr(self, name) not in (None, 1, -1):
                msg = f"{name} is {getattr(self, name)}, must be 1, -1 or None"
                raise ValueError(msg)
        if not self.contact_sd_mm >= 0.0:
            msg = f"contact_sd_mm is {self.contact_sd_mm}, must be >= 0"
            raise ValueError(msg)
