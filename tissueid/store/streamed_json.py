"""JSON documents longer than memory, spelled as :func:`tissueid.store.files.json_bytes` spells them.

Lists that grow with a cohort are gathered element by element in a :class:`JsonList`, which keeps them in a
temporary file, and are copied into the document where they stand.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Mapping
from tempfile import SpooledTemporaryFile
from types import TracebackType
from typing import IO, Any, Self

from tissueid.store.files import plain_json

_INDENT = 2
#: A list stays in memory up to this size [bytes].
_SPOOL_BYTES = 1 << 20


def _spelled(value: Any, level: int) -> bytes:
    """A value as it stands ``level`` levels deep in a document; a line break is never inside a string."""
    text = json.dumps(plain_json(value), ensure_ascii=False, indent=_INDENT, allow_nan=False)
    return text.replace("\n", "\n" + " " * (_INDENT * level)).encode("utf-8")


class JsonList:
    """A list of a document, written down as it grows.

    ``level``: how deep its elements stand in the document: 2 for a list that is a value of its root.
    """

    def __init__(self, level: int) -> None:
        self.level = level
        self.count = 0
        self._file = SpooledTemporaryFile(max_size=_SPOOL_BYTES)  # noqa: SIM115 -- closed by close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._file.close()

    def add(self, value: Any) -> None:
        """Append one element.

        Raises ValueError: for NaN or infinity, which JSON does not have.
        """
        pad = b" " * (_INDENT * self.level)
        self._file.write((b",\n" if self.count else b"\n") + pad + _spelled(value, self.level))
        self.count += 1

    def copy_into(self, stream: IO[bytes]) -> None:
        """Write the whole list."""
        if self.count == 0:
            stream.write(b"[]")
            return
        stream.write(b"[")
        self._file.seek(0)
        shutil.copyfileobj(self._file, stream)
        stream.write(b"\n" + b" " * (_INDENT * (self.level - 1)) + b"]")


def write_json(stream: IO[bytes], value: Any, *, level: int = 0) -> None:
    """Write a document whose mappings may hold :class:`JsonList` in place of lists.

    ``level``: how deep it stands.
    """
    if isinstance(value, JsonList):
        value.copy_into(stream)
    elif isinstance(value, Mapping) and value:
        pad = b" " * (_INDENT * (level + 1))
        for number, (key, child) in enumerate(value.items()):
            stream.write((b",\n" if number else b"{\n") + pad)
            stream.write(json.dumps(str(key), ensure_ascii=False).encode("utf-8") + b": ")
            write_json(stream, child, level=level + 1)
        stream.write(b"\n" + b" " * (_INDENT * level) + b"}")
    else:
        stream.write(_spelled(value, level))
    if level == 0:
        stream.write(b"\n")
