"""A study without the names of people, animals and places, and recordings without their headers.

Names of specimens and donors become keyed hashes (HMAC-SHA256 under a salt that stays with the owner): one
name gives one hash in every export of a laboratory, and nobody without the salt can try names out.  A header
may hold anything, so recordings are not cleaned but written anew: time, displacement, force, in s, mm and N,
every digit kept.  Names that were taken out are blackened in all text that stays.
"""

from __future__ import annotations

import hashlib
import hmac
import re
import secrets
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from tissueid.manifest import Study
from tissueid.store.files import write_file
from tissueid.trial import Trial

#: Name of the salt's file beside the manifest; it is never exported.
SALT_FILE = ".study-salt"
_SALT_BYTES = 32
#: Hexadecimal digits of a hash: 40 bits, no clash among thousands of specimens.
_DIGITS = 10
#: Keys that name people, places or days, or are free text about them.
REMOVED = ("authors", "laboratory", "operator", "date", "ethics", "doi", "description", "notes")
_HASHED = {"specimen": "S", "name": "S", "donor": "D"}
#: Removed names shorter than this are not looked for in other text: they would blacken words.
_SHORTEST_NAME = 3
_BLACKENED = "[removed]"


def read_salt(folder: Path) -> bytes:
    """The salt of a study, made where there is none."""
    file = folder / SALT_FILE
    if not file.is_file():
        write_file(file, secrets.token_hex(_SALT_BYTES).encode("ascii") + b"\n")
    return file.read_bytes().strip()


def recording_text(trial: Trial) -> str:
    """A recording as plain CSV, shortest numbers that read back equal."""
    columns = (trial.time_s.tolist(), trial.displacement_mm.tolist(), trial.force_N.tolist())
    rows = (",".join(map(repr, row)) for row in zip(*columns, strict=True))
    head = f"(s),({trial.axes.length}),({trial.axes.force})"
    return "\n".join(["Time,Displacement,Force", head, *rows, ""])


class Anonymiser:
    """Takes names out of one study.

    ``specimens``: names of specimens in use, listed or not.
    """

    def __init__(self, study: Study, specimens: Iterable[str], salt: bytes) -> None:
        self._salt = salt
        names = set(_names(study)) | {name for name in specimens if len(name) >= _SHORTEST_NAME}
        longest_first = sorted(names, key=len, reverse=True)
        self._names = re.compile("|".join(map(re.escape, longest_first)), re.IGNORECASE) if names else None

    def hashed(self, name: str, letter: str = "S") -> str:
        """A name as its keyed hash: ``"S-3fa9c1b2d4"``."""
        digest = hmac.new(self._salt, name.encode("utf-8"), hashlib.sha256).hexdigest()
        return f"{letter}-{digest[:_DIGITS]}"

    def text(self, text: str) -> str:
        """Text without the names that were taken out."""
        return text if self._names is None else self._names.sub(_BLACKENED, text)

    def table(self, table: Mapping[str, Any], *, named: bool = False) -> dict[str, Any]:
        """A table without what identifies; ``named`` where its ``name`` is a specimen's."""
        kept: dict[str, Any] = {}
        for key, value in table.items():
            if key in REMOVED:
                continue
            if key in _HASHED and (key != "name" or named):
                kept[key] = self.hashed(str(value), _HASHED[key])
            elif isinstance(value, str):
                kept[key] = self.text(value)
            else:
                kept[key] = value
        return kept


def _names(study: Study) -> Iterable[str]:
    """Every name in the study that must not turn up elsewhere."""
    tables = [study.about, *study.specimens.values()]
    for table in tables:
        for key in ("operator", "laboratory", "donor", "name", "ethics"):
            if len(str(table.get(key, ""))) >= _SHORTEST_NAME:
                yield str(table[key])
        for author in table.get("authors", ()):
            yield from (part for part in (author, *author.split()) if len(part) >= _SHORTEST_NAME)
    operator = str(study.about.get("operator", ""))
    yield from (part for part in operator.split() if len(part) >= _SHORTEST_NAME)
