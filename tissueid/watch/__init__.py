"""Beside the machine: new recordings are noticed when they are whole, judged, compared with earlier ones."""

from __future__ import annotations

from tissueid.watch.session import FolderWatch, judge, refused_verdict

__all__ = ["FolderWatch", "judge", "refused_verdict"]
