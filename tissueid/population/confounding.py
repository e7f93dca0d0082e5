"""Confounding of speed and specimen: who was tested how fast, as a graph.

Speeds and specimens are its nodes, logs its edges.  Two speeds can be compared inside specimens where a path
joins them.  Where each speed was tested on specimens of its own no path does, and a difference of force
between speeds is as well one between specimens; the figures of paper A's 18 measurements on 17 heads allow
both readings (a reading).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from tissueid.flags import Flag
from tissueid.population.agreement import SAME_SHARE
from tissueid.population.members import Member

S_PER_MIN = 60.0


@dataclass(frozen=True, slots=True)
class Confounding:
    """Connections of speeds and specimens."""

    #: ``none`` (all speeds meet in specimens), ``partly`` (they fall into parts that share no specimen),
    #: ``confounded`` (no two speeds share a specimen) or ``single speed``.
    kind: str
    speeds_mm_s: tuple[float, ...]
    parts: tuple[tuple[float, ...], ...]  # speeds that hang together

    @property
    def sentence(self) -> str:
        """Sentence on an effect of speed, and its limits."""
        if self.kind == "single speed":
            return "All logs were loaded at one speed: nothing is said of an effect of speed."
        if self.kind == "none":
            return (
                f"All {len(self.speeds_mm_s)} speeds meet in specimens: their effect is seen inside "
                "specimens, apart from how specimens differ."
            )
        said = "; ".join(
            ", ".join(f"{speed * S_PER_MIN:.3g}" for speed in part) + " mm/min" for part in self.parts[:6]
        )
        more = f"; and {len(self.parts) - 6} more" if len(self.parts) > 6 else ""
        if self.kind == "confounded":
            return (
                f"Each speed was tested on specimens of its own ({said}{more}): a difference of force "
                "between speeds may as well be one between specimens, and no effect of speed can be claimed "
                "from this cohort. Test each specimen at several speeds."
            )
        return (
            f"The speeds fall into {len(self.parts)} parts that share no specimen ({said}{more}): speeds of "
            "different parts can't be compared apart from their specimens. Join the parts by specimens "
            "tested at a speed of each."
        )

    def flags(self) -> list[Flag]:
        """``speed_confounded`` where speeds can't be told from specimens."""
        if self.kind in {"none", "single speed"}:
            return []
        message = (
            f"{len(self.speeds_mm_s)} speeds were tested on specimens of their own"
            if self.kind == "confounded"
            else f"the speeds fall into {len(self.parts)} parts that share no specimen"
        )
        return [Flag("speed_confounded", message, {"kind": self.kind, "parts": len(self.parts)})]

    def as_json(self) -> dict[str, Any]:
        """The ``confounding`` object of the schema."""
        return {
            "kind": self.kind,
            "speeds_mm_s": list(self.speeds_mm_s),
            "parts": [list(part) for part in self.parts],
            "sentence": self.sentence,
        }


def _distinct(speeds: Sequence[float]) -> list[float]:
    """Speeds that differ by more than what a machine's setting does."""
    found: list[float] = []
    for speed in sorted(speeds):
        if not found or speed > found[-1] * (1.0 + SAME_SHARE):
            found.append(speed)
    return found


def speed_confounding(members: Sequence[Member]) -> Confounding | None:
    """Connected parts of the graph of speeds and specimens; ``None`` where no speed is known."""
    return confounding_of([[trial.speed_mm_s for trial in one.trials] for one in members])


def confounding_of(speeds_of: Sequence[Sequence[float]]) -> Confounding | None:
    """The same from the speeds of each specimen's tests [mm/s]."""
    tested = [(who, speed) for who, own in enumerate(speeds_of) for speed in own if speed > 0.0]
    speeds = _distinct([speed for _, speed in tested])
    if not speeds:
        return None
    part = list(range(len(speeds)))
    home: dict[int, int] = {}
    for who, speed in tested:
        at = max(k for k, known in enumerate(speeds) if speed >= known * (1.0 - 1e-12))
        other = part[home.setdefault(who, at)]
        mine = part[at]
        part = [mine if one == other else one for one in part]
    parts = tuple(
        tuple(speed for speed, label in zip(speeds, part, strict=True) if label == one)
        for one in dict.fromkeys(part)
    )
    if len(speeds) == 1:
        kind = "single speed"
    elif len(parts) == 1:
        kind = "none"
    else:
        kind = "confounded" if all(len(one) == 1 for one in parts) else "partly"
    return Confounding(kind, tuple(speeds), parts)
