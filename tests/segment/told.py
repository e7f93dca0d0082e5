"""Answers of the segmenter in a word each."""

from __future__ import annotations

from tissueid.flags import Flag
from tissueid.trial import Event, Segmentation


def kinds(found: Segmentation) -> list[str]:
    return [phase.kind for phase in found.phases]


def codes(found: Segmentation) -> set[str]:
    return {flag.code for flag in found.flags}


def flag_of(found: Segmentation, code: str) -> Flag:
    """The one flag of that code."""
    (flag,) = [one for one in found.flags if one.code == code]
    return flag


def events(found: Segmentation, kind: str) -> list[Event]:
    return [event for event in found.events if event.kind == kind]
