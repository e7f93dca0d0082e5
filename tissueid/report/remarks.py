"""The flags of a specimen for a reader: a short title and its gravity for each code, gathered over trials.

The sentence with the numbers is the flag's own; the title says in a few words what it is about, and neither
repeats the other.
"""

from __future__ import annotations

from dataclasses import dataclass

from tissueid.digits import typeset
from tissueid.documents.base import Placed
from tissueid.documents.identification import Relaxation, Specimen, Trial
from tissueid.flags import FLAGS, flag_level, harm_rank

#: From harmless to grave.
LEVELS = ("ok", "note", "caution", "serious")


@dataclass(frozen=True, slots=True)
class Remark:
    """One flag for a reader, gathered over a specimen's trials."""

    code: str
    level: str  # ``note``, ``caution`` or ``serious``
    title: str  # what it is about
    messages: tuple[str, ...]  # its sentences, with numbers; none twice
    where: tuple[str, ...]  # trials that carry it; empty for the specimen as a whole

    @property
    def message(self) -> str:
        """All sentences in one, each closed once, powers of ten raised."""
        return typeset("; ".join(part.rstrip(".") for part in self.messages))


def remark_title(code: str) -> str:
    """Title of a flag; a code of a later version is spelt out."""
    return FLAGS[code].title if code in FLAGS else code.replace("_", " ").capitalize()


def trial_label(trial: Placed) -> str:
    """Short name of a trial: its file, and its sheet where there is one."""
    name = trial.path.replace("\\", "/").rsplit("/", 1)[-1]
    return name if trial.sheet is None else f"{name} [{trial.sheet}]"


def remarks(specimen: Specimen, *, holds: bool = True) -> tuple[Remark, ...]:
    """Every flag of a specimen, its trials and its holds, once a code, the one of most harm first.

    ``specimen``: one of ``specimens`` of identification.json; ``holds``: with what is said of single
    exponentials in the holds.
    """
    messages: dict[str, list[str]] = {}
    where: dict[str, list[str]] = {}
    for flag in specimen.flags:
        said = messages.setdefault(flag.code, [])
        where.setdefault(flag.code, [])
        # several parameters may carry one code: each sentence is kept, and none twice
        if flag.message not in said:
            said.append(flag.message)
    parts: list[Trial | Relaxation] = [*specimen.trials, *(specimen.relaxation if holds else ())]
    for part in parts:
        for flag in part.flags:
            messages.setdefault(flag.code, [flag.message])
            places = where.setdefault(flag.code, [])
            if trial_label(part) not in places:
                places.append(trial_label(part))
    found = [
        Remark(code, flag_level(code), remark_title(code), tuple(said), tuple(where[code]))
        for code, said in messages.items()
    ]
    return tuple(sorted(found, key=lambda remark: harm_rank(remark.code)))
