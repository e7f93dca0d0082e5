"""The error tree: every failure tissueid reports on purpose, with its exit code.

::

    TissueidError              1  never raised itself; 1 means a bug
    +-- UsageError             2  wrong flag, option or path pattern
    +-- InputError             3  a recording or manifest was refused
    +-- NotIdentifiedError     4  a required parameter is not identified, or no convergence
    +-- DeviceError            5  device or safety refusal
    +-- BundleError            6  a bundle or output set is invalid, mixed or not renderable

7 says that a run finished and left something out.  Where several apply, :data:`EXIT_PRECEDENCE` decides.
130 is reserved for an interrupt.
"""

from __future__ import annotations

import unicodedata
from typing import NoReturn

EXIT_OK = 0
EXIT_INTERRUPTED = 130
EXIT_PRECEDENCE = (1, 2, 3, 6, 5, 7, 4)
#: Marks that turn the direction of what follows them.
_OVERRIDES = frozenset("\u202a\u202b\u202c\u202d\u202e\u2066\u2067\u2068\u2069")


def printable(text: str) -> str:
    r"""A text on one line: line breaks, other control characters and what is no Unicode as escapes.

    A file may be named by anything; its name must not fake a line, or steer a terminal.

    >>> printable("a\nb.csv")
    'a\\nb.csv'
    """
    # a zero-width joiner (Cf) holds an emoji together; a direction override would turn the rest around
    return "".join(
        letter.encode("unicode_escape").decode("ascii")
        if unicodedata.category(letter) in {"Cc", "Cs", "Zl", "Zp"} or letter in _OVERRIDES
        else letter
        for letter in text
    )


class TissueidError(Exception):
    """Base of every deliberate failure.

    Parameters
    ----------
    message : str
        What is wrong, with the value, and the way out, in one or two sentences.
    """

    exit_status = 1

    def __init__(self, message: str) -> None:
        super().__init__(message)
        self.message = message


class UsageError(TissueidError):
    """A flag, option or path pattern makes no sense."""

    exit_status = 2


def refuse(message: str) -> NoReturn:
    """Refuse what makes no sense as it was typed, or stated: UsageError."""
    raise UsageError(message)


class InputError(TissueidError):
    """A recording, workbook or manifest can't be trusted and was refused.

    Parameters
    ----------
    code : str
        Stable machine-readable reason, one of the enumeration in ``schemas/inspect.schema.json``.
    message : str
        What is wrong, with the offending value, and the way out.
    path : str
        File as the user named it.
    sheet : str, optional
        Workbook sheet.
    line, column : int, optional
        One-based position of the first offending cell (spreadsheet row and column in a workbook).
    """

    exit_status = 3

    def __init__(
        self,
        code: str,
        message: str,
        *,
        path: str,
        sheet: str | None = None,
        line: int | None = None,
        column: int | None = None,
    ) -> None:
        super().__init__(message)
        self.code = code
        self.path = path
        self.sheet = sheet
        self.line = line
        self.column = column

    def __str__(self) -> str:
        where = self.path
        if self.sheet is not None:
            where += f" [{self.sheet}]"
        if self.line is not None:
            where += f", line {self.line}"
        if self.column is not None:
            where += f", column {self.column}"
        return printable(f"{where}: {self.message}")


class NotIdentifiedError(TissueidError):
    """A parameter that was asked for is not identified by these data, or the fit did not converge."""

    exit_status = 4


class DeviceError(TissueidError):
    """A device could not be used, or a safety rule refused to go on."""

    exit_status = 5


class BundleError(TissueidError):
    """A bundle or an output set is damaged, mixed, of another schema, or can't be rendered."""

    exit_status = 6


def was_interrupted(error: BaseException | None) -> bool:
    """True where an interrupt is behind an error: a compiled kernel wraps one that arrives within it."""
    while error is not None and not isinstance(error, KeyboardInterrupt):
        error = error.__cause__ or error.__context__
    return error is not None


def exit_code(codes: set[int]) -> int:
    """The first of the codes by :data:`EXIT_PRECEDENCE`, or 0."""
    return next((code for code in EXIT_PRECEDENCE if code in codes), EXIT_OK)
