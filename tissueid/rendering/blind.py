"""Comparing tissues without knowing which is felt: order, answer key, consent, pseudonym.

Presentations are numbered; every tissue comes equally often, in an order drawn anew for each session.  The
log knows the numbers alone.  What each was stands in a key file apart, readable by its owner only, which is
written before the first presentation and never printed.
"""

from __future__ import annotations

import json
import os
import re
import secrets
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tissueid.errors import UsageError, printable

#: Read and agreed to before a motor moves.
CONSENT_HARDWARE = """\
This moves the grip of a haptic device with force. No real unit has confirmed this software.
 - Keep hair, cables and fingers away from the arms; hold the grip, and nothing else.
 - The force acts only while the dead-man button is held; let go of the button to end it.
 - Whatever happens: pull the device's power plug. It always ends the force.
 - Do not take part with a pacemaker, or with an injury of hand or arm.
 - tissueid is not a medical device; nothing felt here is a finding about a patient."""

#: Read and agreed to before a blind comparison.
CONSENT_BLIND = """\
You will feel several tissues without being told which is which. Recorded are the movement of the grip and the
forces, under a pseudonym; no name is asked for or stored, and your answers stay on the sheet of whoever asks.
You may stop at any time, without giving a reason, and have the recording deleted. The order of the tissues is
kept in a file apart."""

_PSEUDONYM = re.compile(r"[A-Za-z]{1,3}-?\d{1,5}")
MOST_PRESENTATIONS = 200


@dataclass(frozen=True, slots=True)
class BlindOrder:
    """The order of one session."""

    pseudonym: str
    tissues: tuple[int, ...]  # index of the tissue of each presentation
    seed: int  # it was drawn with


def check_pseudonym(text: str | None) -> str:
    """A pseudonym that is no name: up to three letters and a number; drawn where none is given.

    Raises UsageError: it could be a name.
    """
    if text is None:
        return f"P{secrets.randbelow(90000) + 10000}"
    if _PSEUDONYM.fullmatch(text) is None:
        msg = f"--pseudonym {printable(text)!r} could be a name; use letters and a number as in P17"
        raise UsageError(msg)
    return text


def draw_order(count: int, presentations: int, *, pseudonym: str, seed: int | None = None) -> BlindOrder:
    """A random order in which every tissue comes equally often.

    ``count``: tissues to compare; ``presentations``: a multiple of ``count``; ``seed``: from the operating
    system where none is given.  Raises UsageError: fewer than two tissues, or a number of presentations that
    can't be balanced.
    """
    if count < 2:
        msg = (
            "--blind compares tissues: give a second one with --against, --against-draw or --against-quantile"
        )
        raise UsageError(msg)
    if not (count <= presentations <= MOST_PRESENTATIONS and presentations % count == 0):
        msg = (
            f"--presentations is {presentations}: {count} tissues come equally often, so it must be a "
            f"multiple of {count}, at most {MOST_PRESENTATIONS}"
        )
        raise UsageError(msg)
    seed = secrets.randbits(63) if seed is None else seed
    order = np.random.default_rng(seed).permutation(np.repeat(np.arange(count), presentations // count))
    return BlindOrder(pseudonym, tuple(int(value) for value in order), seed)


def write_key(path: Path, order: BlindOrder, tissues: Sequence[dict[str, Any]]) -> None:
    """Write what each presentation is, for the owner's eyes.

    ``tissues``: what each tissue is: name, bundle, draw.  Raises UsageError: the file exists, or can't be
    written.
    """
    document = {
        "pseudonym": order.pseudonym,
        "seed": order.seed,
        "tissues": list(tissues),
        "presentations": [
            {"number": number, "tissue": tissue} for number, tissue in enumerate(order.tissues, 1)
        ],
    }
    text = json.dumps(document, ensure_ascii=False, indent=2) + "\n"
    try:
        handle = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
        with os.fdopen(handle, "w", encoding="utf-8") as stream:
            stream.write(text)
    except FileExistsError as error:
        msg = f"{path}: exists already; an answer key is never overwritten, choose another --key"
        raise UsageError(msg) from error
    except OSError as error:
        msg = f"{path}: the answer key can't be written ({error.strerror}); choose another --key"
        raise UsageError(msg) from error
