"""A person in a session: what they agreed to, which ethics committee voted, how long it is kept."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from typing import Any

from tissueid.errors import UsageError, printable

__all__ = ["CONSENT_TRAINING", "Participation", "with_consent"]

#: Read and agreed to before a guided session of a person is recorded.
CONSENT_TRAINING = """\
Your hand is guided along a planned axis, and its movement and the forces are recorded under a pseudonym, to
measure how near and how straight it came and whether practice changes that. No name is asked for or stored.
You may stop at any time, without giving a reason, and have your recordings deleted.
No number that comes of it says that you may, or may not, operate on anybody."""

#: A number such as 21-1234-101 or EK 1234/2026: no room for a sentence.
_ETHICS = re.compile(r"[A-Za-z0-9][A-Za-z0-9 ./_-]{1,39}")
#: Longest retention that may be asked for [d]: fifty years.
MOST_DAYS = 18_262


@dataclass(frozen=True, slots=True)
class Participation:
    """What is recorded of a participation, beside the pseudonym.

    Attributes
    ----------
    ethics : str or None
        Number of the ethics committee's vote.
    keep_days : int or None
        After which the recording is to be deleted; None where nothing was stated.

    Raises
    ------
    UsageError
        It is no number of a vote, or no number of days.
    """

    ethics: str | None = None
    keep_days: int | None = None

    def __post_init__(self) -> None:
        if self.ethics is not None and _ETHICS.fullmatch(self.ethics) is None:
            msg = f"--ethics {printable(self.ethics)!r}: give the number of the vote, as in 'EK 1234/2026'"
            raise UsageError(msg)
        if self.keep_days is not None and not 0 < self.keep_days <= MOST_DAYS:
            msg = f"--keep-days is {self.keep_days}, must lie within 1 and {MOST_DAYS}"
            raise UsageError(msg)

    def as_json(self, now: datetime | None = None) -> dict[str, Any]:
        """The ``participation`` of a log's head, without consent so far."""
        today = (now or datetime.now(UTC)).date()
        last = None if self.keep_days is None else (today + timedelta(days=self.keep_days)).isoformat()
        return {"consent": None, "ethics": self.ethics, "delete_after": last}


def with_consent(head: Mapping[str, Any], *, how: str) -> dict[str, Any]:
    """A head whose participation says how consent was given; any other head as it is.

    Parameters
    ----------
    head : mapping
    how : {"asked", "given before"}
    """
    there = head.get("participation")
    return dict(head) if there is None else {**head, "participation": {**there, "consent": how}}
