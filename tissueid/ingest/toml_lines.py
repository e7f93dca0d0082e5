"""On which line of a TOML text each table and key stands: the parser gives values without places.

The text has been parsed by then, so that only its shape is followed: headers, keys, and values that go on
over several lines.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterator

#: Keys and positions in arrays, from the root.
TomlPath = tuple[str | int, ...]

_PART = r"(?:[A-Za-z0-9_-]+|\"(?:[^\"\\]|\\.)*\"|'[^']*')"
_DOTTED = rf"{_PART}(?:\s*\.\s*{_PART})*"
_HEADER = re.compile(rf"\s*(\[\[?)\s*({_DOTTED})\s*\]\]?\s*(?:#.*)?$")
_KEY = re.compile(rf"\s*({_DOTTED})\s*=\s*(.*)$")
#: What opens or closes a value, or hides such signs: strings, comments, brackets.
_TOKEN = re.compile(r'"""|\'\'\'|"(?:[^"\\]|\\.)*"|\'[^\']*\'|#|[\[\]{}]')


def _parts(dotted: str) -> list[str]:
    """Parts of a dotted key, unquoted."""
    parts = [found[0] for found in re.finditer(_PART, dotted)]
    return [tomllib.loads(f"x = {part}")["x"] if part[0] in "\"'" else part for part in parts]


class _Value:
    """Follows a value over its lines until its brackets and long strings are closed."""

    def __init__(self) -> None:
        self.depth = 0
        self.quote = ""

    @property
    def open(self) -> bool:
        """True where the value goes on in the next line."""
        return self.depth > 0 or bool(self.quote)

    def feed(self, text: str) -> None:
        """Read one line, or what follows the equals sign."""
        while text:
            if self.quote:
                end = text.find(self.quote)
                if end < 0:
                    return
                text, self.quote = text[end + 3 :], ""
                continue
            token = _TOKEN.search(text)
            if token is None or token[0] == "#":
                return
            if token[0] in {'"""', "'''"}:
                self.quote = token[0]
            self.depth += (token[0] in "[{") - (token[0] in "]}")
            text = text[token.end() :]


def _resolved(parts: list[str], counts: dict[TomlPath, int]) -> TomlPath:
    """A header's path with the position of the latest entry after every array of tables."""
    path: TomlPath = ()
    for part in parts:
        path = (*path, part)
        if path in counts:
            path = (*path, counts[path])
    return path


def _places(text: str) -> Iterator[tuple[TomlPath, int]]:
    counts: dict[TomlPath, int] = {}
    table: TomlPath = ()
    value = _Value()
    for number, line in enumerate(text.split("\n"), start=1):
        if value.open:
            value.feed(line)
            continue
        header = _HEADER.match(line)
        if header:
            parts = _parts(header[2])
            if header[1] == "[[":
                array = (*_resolved(parts[:-1], counts), parts[-1])
                counts[array] = counts.get(array, -1) + 1
            table = _resolved(parts, counts)
            yield table, number
            continue
        key = _KEY.match(line)
        if key:
            yield (*table, *_parts(key[1])), number
            value.feed(key[2])


def lines_of_toml(text: str) -> dict[TomlPath, int]:
    r"""Line, from 1, of every table and key of a valid TOML text.

    Examples
    --------
    >>> lines_of_toml("[a]\nx = 1\n[[b]]\ny = 2\n[[b]]\n")
    {('a',): 1, ('a', 'x'): 2, ('b', 0): 3, ('b', 0, 'y'): 4, ('b', 1): 5}
    """
    lines: dict[TomlPath, int] = {}
    for path, line in _places(text):
        lines.setdefault(path, line)
    return lines


def line_of(lines: dict[TomlPath, int], path: TomlPath) -> int | None:
    """The line of a path, or of the nearest table around it."""
    for end in range(len(path), 0, -1):
        if path[:end] in lines:
            return lines[path[:end]]
    return None
