"""An address as a QR code for a terminal, so that a telephone or tablet need not type a token."""

from __future__ import annotations

import io

import segno

__all__ = ["terminal_code"]


def terminal_code(url: str) -> str:
    """The code of an address, in half blocks, two rows a line.

    Parameters
    ----------
    url : str
    """
    text = io.StringIO()
    segno.make_qr(url, error="l").terminal(out=text, compact=True)
    return text.getvalue()
