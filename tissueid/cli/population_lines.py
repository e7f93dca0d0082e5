"""A population on the terminal."""

from __future__ import annotations

from typing import TYPE_CHECKING

from tissueid.cli.output import echo, note
from tissueid.digits import together
from tissueid.documents import typed
from tissueid.documents.population import Population
from tissueid.flags import warning_line

if TYPE_CHECKING:
    from tissueid.study.cohort import WrittenPopulation


def print_population(written: WrittenPopulation, out: str, *, quiet: int) -> None:
    """Quantities with their spread, held-out specimens, remarks; specimens that take no part go to stderr.

    ``out``: the output folder, as it was named; ``quiet``: 1 leaves the table out, 2 the specimens too.
    """
    if not quiet:
        _print_table(written, out)
    for one in written.fit.left_out:
        note(f"left out: {one.specimen}: {one.reason}", quiet=quiet)


def _print_table(written: WrittenPopulation, out: str) -> None:
    document = typed(written.document, Population)
    found = document.population
    assert found is not None  # noqa: S101  (asked before)
    count = len(document.specimens_used)
    echo()
    echo(f"population of {count} specimens, to {found.depth_mm:.3g} mm", bold=True)
    for row in found.quantities:
        median, low, high, *wide = together(
            [row.median, *row.ci95, *(row.ci95_total or ())], (row.ci95[1] - row.ci95[0]) / 4.0
        )
        first, last = row.cv_ci95
        total = "" if row.ci95_total is None else f"; with the machine {' to '.join(wide)}"
        unit = "" if row.unit == "1" else f" {row.unit}"
        echo(
            f"  {row.words:<34} {median}{unit} (95 %: {low} to {high}{total}), "
            f"between specimens CV {100 * row.cv:.1f} % ({100 * first:.1f} to {100 * last:.1f})",
        )
    if found.held_out is not None:
        by = found.held_out.nrmsd_range
        echo(
            f"  held-out specimens: NRMSD {100 * by.median:.1f} % of range "
            f"(68 %: {100 * by.low68:.1f} to {100 * by.high68:.1f})",
        )
    for flag in document.flags:
        echo(f"  ! {warning_line(flag.code, flag.message)}", fg="yellow")
    echo()
    if not written.felt:
        echo("No population.h5: specimens drawn from so open a population have no force that is a number")
    echo(f"Report: {out}/cohort.html")
