"""Warnings of ``fit``: the few of most harm a specimen, and once a batch what most of it shares.

A warning is at most 25 words: what was seen, with its number, and the way out.  ``-v`` prints them all.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

from tissueid.documents.identification import Specimen
from tissueid.flags import FLAGS, harm_rank, warning_line

#: Warnings of a specimen, and of a batch as a whole, without ``-v``.
MOST_WARNINGS = 5
#: A flag of so many specimens, and of this share of a batch, is counted once.
SHARED_FROM = 3
SHARED_SHARE = 0.5
#: Remarks that every other recording has; ``inspect``, the report and ``-v`` show them.
UNREMARKABLE = frozenset(
    {"starts_in_contact", "no_hold", "several_steps", "event_rows", "column_choice", "undecoded_text"}
)


def _codes(specimen: Specimen) -> set[str]:
    own = [*specimen.flags, *(flag for trial in specimen.trials for flag in trial.flags)]
    return {flag.code for flag in own} - UNREMARKABLE


def shared_codes(specimens: Sequence[Specimen]) -> tuple[str, ...]:
    """Codes that most specimens of a batch carry, the worst first.

    ``specimens``: ``specimens`` of identification.json.
    """
    counted = Counter(code for specimen in specimens for code in _codes(specimen))
    least = max(SHARED_FROM, SHARED_SHARE * len(specimens))
    return tuple(sorted((code for code, count in counted.items() if count >= least), key=harm_rank))


def shared_lines(specimens: Sequence[Specimen], codes: Sequence[str]) -> list[str]:
    """``24 of 29 sheets start preloaded. Start in air, or state --contact.``, a line a code.

    ``codes``: of :func:`shared_codes`.
    """
    lines = [_shared_line(specimens, code) for code in codes[:MOST_WARNINGS]]
    if len(codes) > MOST_WARNINGS:
        lines[-1] += f" ({len(codes) - MOST_WARNINGS} more: -v, or the report)"
    return lines


def _shared_line(specimens: Sequence[Specimen], code: str) -> str:
    trials = [trial for specimen in specimens for trial in specimen.trials]
    carriers = [trial for trial in trials if code in {flag.code for flag in trial.flags}]
    if carriers:
        noun = "sheets" if all(trial.sheet is not None for trial in trials) else "recordings"
        count, total = len(carriers), len(trials)
    else:
        noun, total = "specimens", len(specimens)
        count = sum(code in _codes(specimen) for specimen in specimens)
    advice = FLAGS.get(code)
    said = "carry " + code if advice is None else advice.many
    return warning_line(code, f"{count} of {total} {noun} {said}")


def warning_lines(
    specimen: Specimen, *, shared: Sequence[str] = (), verbose: int = 0, alarms: int = 0
) -> list[tuple[str, str]]:
    """Warnings of a specimen with their level, the worst first.

    ``specimen``: a specimen of identification.json; ``shared``: codes that are counted once for the batch;
    ``verbose``: above 0 nothing is left out; ``alarms``: lines that are said already, of the few.
    """
    from tissueid.report.remarks import remarks

    found = remarks(specimen, holds=verbose > 0)
    hidden = frozenset() if verbose else UNREMARKABLE | frozenset(shared)
    kept = [one for one in found if one.code not in hidden]
    room = len(kept) if verbose else max(MOST_WARNINGS - alarms, 1)
    logs = len(specimen.trials)
    lines = []
    for remark in kept[:room]:
        logs_of = "" if logs == 1 or not remark.where else f"{_where(remark.where, logs)}: "
        more = f" ({len(remark.messages) - 1} more)" if len(remark.messages) > 1 else ""
        lines.append((remark.level, f"{logs_of}{warning_line(remark.code, remark.messages[0])}{more}"))
    if len(kept) > room:
        level, last = lines[-1]
        lines[-1] = (level, f"{last} ({len(kept) - room} more: -v)")
    return lines


def _where(places: Sequence[str], logs: int) -> str:
    return places[0] if len(places) == 1 else f"{len(places)} of {logs} logs"
