"""File names of a run; those of specimens are readable, unique, and valid on every file system.

A specimen may be called anything a lab writes into a header field: with slashes, in Chinese, ``CON``,
400 characters long, or like another but for its case.
"""

from __future__ import annotations

import hashlib
import unicodedata
from collections.abc import Iterable

#: Public files of a run.
IDENTIFICATION = "identification.json"
CURVES = "curves.h5"
POSTERIORS = "posteriors.h5"
REPORT = "report.html"
ONLY_BUNDLE = "bundle.h5"

# Device names that Windows keeps for itself, whatever their extension
_RESERVED = frozenset(
    {"con", "prn", "aux", "nul", "conin$", "conout$"}
    | {f"{port}{digit}" for port in ("com", "lpt") for digit in "0123456789¹²³"}
)

#: Longest safe name in UTF-8 bytes: most file systems allow 255, and paths are long already.
_LONGEST_BYTES = 80


def safe_name(name: str) -> str:
    """Turn a name into a part of a file name: letters and digits of any script, ``.``, ``_``, ``-``.

    Different names may come out alike; :func:`file_names` keeps them apart.

    Returns at most 80 bytes of UTF-8, never empty, not reserved, not beginning or ending with a dot.
    """
    composed = unicodedata.normalize("NFC", name)
    kept = "".join(char if char.isalnum() or char in "._-" else "_" for char in composed)
    while len(kept.encode("utf-8")) > _LONGEST_BYTES:
        kept = kept[:-1]
    kept = kept.strip("._ ") or "specimen"
    return f"{kept}_" if kept.split(".")[0].casefold() in _RESERVED else kept


def bundle_names(specimens: Iterable[str]) -> dict[str, str]:
    """Name the bundle file of every specimen: ``{"kidney 3": "bundle-kidney_3.h5"}``."""
    return file_names(specimens, "bundle", ".h5")


def file_names(specimens: Iterable[str], stem: str, suffix: str) -> dict[str, str]:
    """Name a file of every specimen: ``{"kidney 3": "stem-kidney_3.suffix"}``.

    Where two names would meet on a file system that ignores case or composes letters differently,
    each gets eight digits of its own hash, whatever their order.

    ``specimens``: distinct names; ``stem``, ``suffix``: what the files begin and end with.
    """
    specimens = list(specimens)
    plain = {specimen: safe_name(specimen) for specimen in specimens}
    met: dict[str, int] = {}
    for name in plain.values():
        met[_folded(name)] = met.get(_folded(name), 0) + 1
    names = {}
    for specimen, name in plain.items():
        mark = hashlib.sha256(specimen.encode("utf-8")).hexdigest()[:8]
        own = name if met[_folded(name)] == 1 else f"{name}-{mark}"
        names[specimen] = f"{stem}-{own}{suffix}"
    return names


def _folded(name: str) -> str:
    return unicodedata.normalize("NFKC", name).casefold()
