"""Beside the machine: new recordings are noticed when they are whole, judged, compared with earlier ones."""

from __future__ import annotations

from tissueid.watch.folder import FolderWatch
from tissueid.watch.session import judge, refused_verdict

__all__ = ["FolderWatch", "judge", "refused_verdict"]
