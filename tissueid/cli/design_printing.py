"""A plan in the terminal: verdict, ranked table, what it is compared with, what limits it."""

from __future__ import annotations

from tissueid.cli.output import Column, echo, echo_table
from tissueid.documents.design import Design, Protocol

_SHORT = {"relaxation_time_s": "tau", "viscosity_N_s_per_mm": "eta", "stiffness_0_N_per_mm": "K"}
MINUTE, HOUR = 60.0, 3600.0
#: Limits that are printed; the page has them all.
PRINTED_LIMITS = 5


def time_words(seconds: float) -> str:
    """``35 min`` or ``2.4 h``."""
    if seconds < 2.0 * MINUTE:
        return f"{seconds:.0f} s"
    return f"{seconds / MINUTE:.1f} min" if seconds < 2.0 * HOUR else f"{seconds / HOUR:.2f} h"


def short_name(name: str) -> str:
    """``tau_b2`` for the relaxation time of the second branch."""
    for full, short in _SHORT.items():
        if name == full or name.startswith(f"{full}_b"):
            return short + name.removeprefix(full)
    return name


def _percent(share: float) -> str:
    return f"{100.0 * share:.3g} %"


def _indentations(protocol: Protocol) -> str:
    return "\n".join(f"{one.repeats} x {one.words}" for one in protocol.indentations)


def print_plan(document: Design) -> None:
    """Print the plan to stdout."""
    asked, best = document.asked, document.protocols[0]
    wanted = ", ".join(f"{short_name(one.name)} to {_percent(one.share)}" for one in asked.wants)
    head = f"{document.tissue.name} on {document.machine.name}: {wanted} ({asked.interval})"
    echo(head)
    if document.verdict.reached:
        said = f"recommended: {best.logs} logs, {time_words(best.seconds)} a specimen"
        if asked.specimens > 1:
            said += f", {time_words(best.total_seconds)} for {asked.specimens}"
    else:
        reached = ", ".join(f"{short_name(one.name)} to {_percent(one.assured)}" for one in best.precision)
        said = f"NONE on this machine reaches that; the nearest: {reached}"
    echo(said)
    titles = ["", "time", "logs", *(short_name(one.name) for one in asked.wants)]
    columns = [*(Column(title, "right") for title in titles), Column("channel"), Column("indentations")]
    rows = [_row(str(rank), one) for rank, one in enumerate(document.protocols, start=1)]
    given = document.against
    if given is not None and given.protocol is not None:
        rows.append(_row(given.name, given.protocol))
    echo_table(columns, rows, dim_last=given is not None and given.protocol is not None)
    if given is not None and given.protocol is None:
        echo(f"{given.name} can't be run here: {given.obstacle}")
    _print_limits(document)
    for remark in document.verdict.remarks:
        echo(f"note: {remark}")


def _row(rank: str, protocol: Protocol) -> list[str]:
    precision = [_percent(one.assured) for one in protocol.precision]
    setting = protocol.setting
    low_pass = f", filter {setting.filter_s:g} s" if setting.filter_s > 0.0 else ""
    channel = f"{setting.rate_Hz:g} Hz{low_pass}"
    time, logs = time_words(protocol.seconds), str(protocol.logs)
    return [rank, time, logs, *precision, channel, _indentations(protocol)]


def _print_limits(document: Design) -> None:
    limits = document.verdict.limits
    if not limits and not document.verdict.reached:
        echo("no single change of machine or channel would help by a tenth")
    for one in limits[:PRINTED_LIMITS]:
        much = "that would be enough" if one.enough else f"{one.factor:.2g} times as precise"
        echo(f"limited by {one.name}: {one.words}: {much}")
