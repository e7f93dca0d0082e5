"""``tissueid doctor``."""

from __future__ import annotations

from dataclasses import asdict

from tissueid.cli.flags import OutputFlags, option, subcommand
from tissueid.cli.output import EXIT_INCOMPLETE, echo, echo_json, note

_MARKS = {"ok": "ok", "note": "note", "missing": "MISSING"}


class _DoctorFlags(OutputFlags):
    warm: bool = option("Compile everything now, so that no later run has to.")


@subcommand("doctor", "--warm", "--json")
def command(flags: _DoctorFlags) -> int:
    """Say what this machine can do with tissueid, and what stands in its way.

    Versions, numba's cache, real-time rights of the servo, devices, the viewer's page and a browser; each
    with what to type where something is wanting. Nothing moves: devices are looked for, none is opened. Exit
    code 7 where a part of tissueid does not work here.
    """
    from tissueid.doctor import examine, warm

    if flags.warm:
        warm(lambda words: note(words, quiet=flags.quiet))
    checks = []
    for check in examine():
        checks.append(check)
        if flags.as_json or flags.quiet:
            continue
        echo(f"{_MARKS[check.state]:<8}{check.name:<13}{check.words}")
        if check.way_out:
            echo(f"{'':21}{check.way_out}")
    missing = [check.name for check in checks if check.state == "missing"]
    if flags.as_json:
        echo_json({"checks": [asdict(check) for check in checks], "missing": missing})
    return EXIT_INCOMPLETE if missing else 0
