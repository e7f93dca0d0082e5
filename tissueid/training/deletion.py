"""Which logs of persons are to be deleted: all of a pseudonym, or those whose time is over.

What a backup or the medium still holds is beyond a program: it says what it unlinked, and nothing else.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from datetime import date
from pathlib import Path

from tissueid.errors import BundleError
from tissueid.store.session_log import read_session_log

__all__ = ["Doomed", "doomed_logs"]

#: Of the answers of a blind comparison, beside its log.
KEY_SUFFIX = ".key.json"


@dataclass(frozen=True, slots=True)
class Doomed:
    """A log that is to be deleted, with what belongs to it.

    Attributes
    ----------
    log : Path
    pseudonym : str
    why : str
    beside : tuple of Path
        The answer key of a blind comparison.
    """

    log: Path
    pseudonym: str
    why: str
    beside: tuple[Path, ...]

    def delete(self) -> None:
        """Unlink it; what is gone already is no error.

        Raises
        ------
        OSError
            It may not be deleted.
        """
        # the log last: as long as it is there, the rest of it can be found again
        for path in (*self.beside, self.log):
            path.unlink(missing_ok=True)


def doomed_logs(
    logs: Iterable[Path], *, pseudonym: str | None, today: date | None
) -> tuple[list[Doomed], list[tuple[Path, str]]]:
    """Logs of a person, or those whose time is over.

    Parameters
    ----------
    logs : iterable of Path
    pseudonym : str or None
        All of this person's, however long they were to be kept.
    today : date or None
        Those that were to be deleted before this day.

    Returns
    -------
    doomed : list of Doomed
    unread : list of (Path, str)
        What could not be read, and why: whose it is, nobody knows.
    """
    doomed, unread = [], []
    for path in logs:
        try:
            head = read_session_log(path).head
        except (BundleError, OSError) as error:
            unread.append((path, getattr(error, "message", str(error))))
            continue
        whose = head["pseudonym"]
        if whose is None:
            continue
        last = (head.get("participation") or {}).get("delete_after")
        if pseudonym is not None and whose.casefold() == pseudonym.casefold():
            why = "asked for by pseudonym"
        elif today is not None and last is not None and date.fromisoformat(last) < today:
            why = f"was to be deleted after {last}"
        else:
            continue
        key = path.with_suffix(KEY_SUFFIX)
        doomed.append(Doomed(path, whose, why, (key,) if key.is_file() else ()))
    return doomed, unread
