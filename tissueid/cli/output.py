"""Printing: JSON, tables and progress. Numbers go to stdout, everything else to stderr."""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import click

__all__ = ["echo_bytes", "echo_json", "note", "output_options", "progress_bar", "with_error", "write_output"]

#: Significant digits of a standard error in print.
ERROR_DIGITS = 2


def output_options(function: Callable[..., Any]) -> Callable[..., Any]:
    """Add ``--json``, ``-v`` and ``-q`` to a sub-command."""
    function = click.option("--json", "as_json", is_flag=True, help="Print one JSON document to stdout.")(
        function
    )
    function = click.option("-v", "--verbose", count=True, help="Say more; a bug shows its traceback.")(
        function
    )
    return click.option("-q", "--quiet", count=True, help="Print errors only.")(function)


def echo_json(document: Any) -> None:
    """One JSON document to stdout, in UTF-8 whatever the terminal's encoding."""
    text = json.dumps(document, indent=2, ensure_ascii=False, allow_nan=False)
    echo_bytes(text.encode("utf-8") + b"\n")


def echo_bytes(content: bytes) -> None:
    """UTF-8 text to stdout as it is: neither the terminal's encoding nor its line ends change it."""
    stream = getattr(sys.stdout, "buffer", None)
    if stream is None:
        click.echo(content.decode("utf-8"), nl=False)
    else:
        sys.stdout.flush()
        stream.write(content)
        stream.flush()


def note(message: str, *, quiet: int = 0) -> None:
    """A line on stderr."""
    if not quiet:
        click.echo(message, err=True)


def write_output(path: str, content: bytes) -> None:
    """Write a file the user named, whole or not at all.

    Raises
    ------
    UsageError
        If it can't be written there.
    """
    from pathlib import Path

    from tissueid.errors import UsageError
    from tissueid.store.files import write_file

    try:
        write_file(Path(path), content)
    except OSError as error:
        msg = f"{path}: can't be written ({error.strerror}); choose another place"
        raise UsageError(msg) from error


#: Numbers below this are printed with a power of ten.
SMALL = 1e-3


def with_error(value: float, stderr: float | None) -> str:
    """A number rounded to the digits its standard error supports: ``0.0209 ± 0.0008``."""
    if stderr is None or not stderr > 0.0 or not math.isfinite(stderr):
        return f"{value:.4g}"
    largest = max(abs(value), stderr)
    if largest < SMALL:
        # micro-newton: (5.17 ± 0.11)e-06 instead of a row of zeros
        exponent = math.floor(math.log10(largest))
        return f"({with_error(value / 10.0**exponent, stderr / 10.0**exponent)})e{exponent:03d}"
    places = max(ERROR_DIGITS - 1 - math.floor(math.log10(stderr)), 0)
    if places > 12:
        return f"{value:.6g} ± {stderr:.1e}"
    return f"{value:.{places}f} ± {stderr:.{places}f}"


@contextmanager
def progress_bar(*, show: bool) -> Iterator[Callable[[str, int, int], None]]:
    """A progress line on stderr while it is a terminal; silent in pipes.

    Yields
    ------
    callable
        ``report(message, done, total)``; total 0 is "not known yet".
    """
    if not (show and sys.stderr.isatty()):
        yield lambda _message, _done, _total: None
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

    columns = (
        SpinnerColumn(),
        BarColumn(bar_width=24),
        TextColumn("{task.fields[count]}"),
        TimeElapsedColumn(),
        TextColumn("{task.description}"),
    )
    with Progress(*columns, console=Console(stderr=True), transient=True) as progress:
        task = progress.add_task("starting", total=None, count="")

        def report(message: str, done: int, total: int) -> None:
            progress.update(
                task,
                description=message[:70],
                completed=done,
                total=total or None,
                count=f"{done}/{total}" if total else f"{done}",
            )

        yield report
