"""Documents: files and the output of ``--json``, as types."""

from tissueid.documents.base import plain, typed

__all__ = ["plain", "typed"]
