"""HTML pages, self-contained: the report of a fit, and the inspection of recordings before one."""

from __future__ import annotations

from tissueid.report.inspect_page import inspected_recording, render_inspection
from tissueid.report.page import render_report

__all__ = ["inspected_recording", "render_inspection", "render_report"]
