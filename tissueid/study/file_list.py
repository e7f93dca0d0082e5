"""The files of a request in their order, few bytes each: a cohort may have a million of them."""

from __future__ import annotations

import os
from array import array
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import overload

from tissueid.result import Refusal

#: A file, and the sheet that the user named with it.
Named = tuple[Path, str | None]


class FileList(Sequence["Named | Refusal"]):
    """Paths in one block of bytes, 8 beside each; sheets and refusals, which are few, in tables."""

    def __init__(self, items: Iterable[Named | Refusal] = ()) -> None:
        self._text = bytearray()
        self._end = array("Q", [0])
        self._sheets: dict[int, str] = {}
        self._refusals: dict[int, Refusal] = {}
        for item in items:
            self.add(item)

    def add(self, item: Named | Refusal) -> None:
        """Put a file, or the refusal in its place, at the end."""
        number = len(self)
        if isinstance(item, Refusal):
            self._refusals[number] = item
        else:
            path, sheet = item
            self._text += os.fsencode(path)
            if sheet is not None:
                self._sheets[number] = sheet
        self._end.append(len(self._text))

    def __len__(self) -> int:
        return len(self._end) - 1

    @overload
    def __getitem__(self, number: int) -> Named | Refusal: ...
    @overload
    def __getitem__(self, number: slice) -> Sequence[Named | Refusal]: ...
    def __getitem__(self, number: int | slice) -> Named | Refusal | Sequence[Named | Refusal]:
        if isinstance(number, slice):
            return FileList(self[one] for one in range(*number.indices(len(self))))
        if number < 0:
            number += len(self)
        if not 0 <= number < len(self):
            raise IndexError(number)
        if number in self._refusals:
            return self._refusals[number]
        name = bytes(self._text[self._end[number] : self._end[number + 1]])
        return Path(os.fsdecode(name)), self._sheets.get(number)

    def __iter__(self) -> Iterator[Named | Refusal]:
        return (self[number] for number in range(len(self)))
