"""The HTML report: one self-contained page made from identification.json and the curves alone."""

from __future__ import annotations

from tissueid.report.page import render_report

__all__ = ["render_report"]
