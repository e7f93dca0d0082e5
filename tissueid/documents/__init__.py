"""Documents: files and the output of ``--json``, as types."""

from tissueid.documents.base import members, plain, typed

__all__ = ["members", "plain", "typed"]
