"""Printing: JSON, tables and progress. Numbers go to stdout, everything else to stderr."""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from textwrap import wrap
from typing import TYPE_CHECKING, Any, Literal, TypeVar

import click

from tissueid.digits import plain_exponents, typeset
from tissueid.errors import printable, refuse

if TYPE_CHECKING:
    from tissueid.cli.flags import OutputFlags

_T = TypeVar("_T")

#: Exit code of a run that finished and left something out.
EXIT_INCOMPLETE = 7
#: Columns, and where texts behind a label begin.
WIDTH, MARGIN = 98, 16
#: Marks of direction that are no control characters.
_MARKS = re.compile("[\u200e\u200f\u061c]")
#: Everything that steers a terminal and may stand raw in JSON.
_STEERING = re.compile("[\x7f-\x9f\u2028\u2029\u200e\u200f\u061c\u202a-\u202e\u2066-\u2069]")
_TYPED_MINUS = re.compile(r"−(?=[\d.])")


def terminal_line(text: str) -> str:
    r"""One line for a terminal: no control character, escape or bidi mark of a file or a label is left raw.

    Powers of ten are raised; a minus before a digit is one that can be typed.

    >>> terminal_line("\x1b[2Jliver\n1.2e-05")
    '\\x1b[2Jliver\\n1.2×10⁻⁵'
    """
    return _TYPED_MINUS.sub("-", _MARKS.sub(_escaped, printable(typeset(text))))


def _escaped(found: re.Match[str]) -> str:
    return f"\\u{ord(found[0]):04x}"


def _written(text: str, stream: Any) -> str:
    """The text in letters that the stream's encoding has."""
    encoding = getattr(stream, "encoding", None) or "utf-8"
    typewritten = str.maketrans({"±": "+-", "×": "x", "·": "*"})
    for plainer in (str, plain_exponents, lambda text: text.translate(typewritten)):
        text = plainer(text)
        with suppress(UnicodeEncodeError):
            text.encode(encoding)
            return text
    return text.encode(encoding, "backslashreplace").decode(encoding)


def echo(message: str = "", *, err: bool = False, fg: str | None = None, bold: bool = False) -> None:
    """One line to stdout or stderr, line breaks as escapes: the only way by which words reach a terminal."""
    line = _written(terminal_line(message), sys.stderr if err else sys.stdout)
    click.echo(click.style(line, fg=fg, bold=bold or None) if fg or bold else line, err=err)


def echo_lines(lines: Iterable[str]) -> None:
    """Lines to stdout."""
    for line in lines:
        echo(line)


def labelled(label: str, text: str) -> list[str]:
    """A text behind its label, in lines that a terminal holds; no line of an empty one."""
    first = f"  {label + ':':<{MARGIN - 2}}"
    return wrap(text, WIDTH, initial_indent=first, subsequent_indent=" " * MARGIN, break_on_hyphens=False)


def echo_table(
    heads: Sequence[str], rows: Sequence[Sequence[str]], *, numbers: int, dim_last: bool = False
) -> None:
    """A table to stdout, whose first columns hold ``numbers``; a cell may have several lines."""
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    table = Table(box=None, pad_edge=False, header_style="bold")
    for place, head in enumerate(heads):
        side: Literal["left", "right"] = "right" if place < numbers else "left"
        table.add_column(Text(terminal_line(head)), justify=side, overflow="fold")
    for place, row in enumerate(rows, start=1):
        cells = ["\n".join(terminal_line(line) for line in cell.split("\n")) for cell in row]
        table.add_row(
            *(Text(_written(cell, sys.stdout)) for cell in cells),
            style="dim" if dim_last and place == len(rows) else None,
        )
    Console(highlight=False).print(table)


def draw(text: str) -> None:
    """Draw the program's own marks on stderr, as it is: a live line, a bell, a code of blocks."""
    click.echo(text, nl=False, err=True)


def echo_json(document: Any) -> None:
    """One JSON document to stdout, in UTF-8 whatever the terminal's encoding."""
    echo_json_text(json.dumps(document, indent=2, ensure_ascii=False, allow_nan=False))


def echo_json_text(text: str) -> None:
    """A JSON document as it was written; what could steer a terminal as JSON's own escapes."""
    echo_bytes(_STEERING.sub(_escaped, text).removesuffix("\n").encode("utf-8") + b"\n", safe=True)


def echo_bytes(content: bytes, *, safe: bool = False) -> None:
    """UTF-8 text to stdout as it is; on a terminal its lines are escaped, unless it is known to be safe."""
    if not safe and sys.stdout.isatty():
        echo_lines(content.decode("utf-8", "backslashreplace").removesuffix("\n").split("\n"))
        return
    stream = getattr(sys.stdout, "buffer", None)
    if stream is None:
        click.echo(content.decode("utf-8"), nl=False)
    else:
        sys.stdout.flush()
        stream.write(content)
        stream.flush()


def tell(flags: OutputFlags, document: Any, lines: Iterable[str]) -> None:
    """The JSON document where it was asked for, else lines of it; neither where it shall be quiet."""
    if flags.as_json:
        echo_json(document)
    elif not flags.quiet:
        echo_lines(lines)


def note(message: str, *, quiet: int = 0) -> None:
    """A line on stderr."""
    if not quiet:
        echo(message, err=True)


def write_output(
    path: str | Path, content: bytes, *, quiet: int = 1, way_out: str = "choose another place"
) -> None:
    """Write a file the user named, whole or not at all, and say so where not ``quiet``."""
    from tissueid.store.files import write_file

    place = Path(path)
    with refusing(path, "written", way_out):
        # what a link leads to is written, and the link stays: /dev/stdout is one
        write_file(place.resolve() if place.is_symlink() and place.is_file() else place, content)
    note(f"wrote {path}", quiet=quiet)


def made_folder(path: str | Path, way_out: str = "choose another folder with -o") -> Path:
    """The folder the user named, made where it is missing."""
    folder = Path(path)
    with refusing(path, "made", way_out):
        folder.mkdir(parents=True, exist_ok=True)
    return folder


@contextmanager
def refusing(path: str | Path, done: str, way_out: str) -> Iterator[None]:
    """Refuse a place the user named where the system refuses it, with the way out."""
    try:
        yield
    except OSError as error:
        refuse(f"{path}: can't be {done} ({error.strerror}); {way_out}")


def checked(written: Any, kind: type[_T], *, where: str) -> tuple[Any, _T]:
    """A document in plain values, and the same as its type."""
    from tissueid.documents import plain
    from tissueid.store.schema import check

    document = plain(written)
    return document, check(document, kind, where=where)


def refuse_foreign(folder: Path, names: Iterable[str], maker: str, why: str) -> None:
    """Refuse to write over files of our names that stand there without the one that goes with them."""
    foreign = [name for name in names if (folder / name).exists()]
    if foreign and not (folder / maker).exists():
        refuse(f"{folder} holds {', '.join(foreign)} {why}: choose another folder with -o")


@contextmanager
def progress_bar(*, show: bool) -> Iterator[Callable[[str, int, int], None]]:
    """A progress line on a terminal's stderr; yields ``report(message, done, total)``, total 0: unknown."""
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
        TextColumn("{task.description}", markup=False),
    )
    with Progress(*columns, console=Console(stderr=True), transient=True) as progress:
        task = progress.add_task("starting", total=None, count="")

        def report(message: str, done: int, total: int) -> None:
            progress.update(
                task,
                description=terminal_line(message)[:70],
                completed=done,
                total=total or None,
                count=f"{done}/{total}" if total else f"{done}",
            )

        yield report
