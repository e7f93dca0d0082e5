"""The frame file of ``tissueid calibrate-frame``: checked when it is read, as everything else is."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

import numpy as np

from tissueid.errors import InputError
from tissueid.manifest import FrameCurve
from tissueid.store.schema import first_problem


def read_frame(path: str | Path) -> FrameCurve:
    """Read a frame file.

    Raises InputError: ``invalid_frame``: no JSON, not a frame, or knots that do not belong together.
    """
    file = Path(path)
    way_out = "write it again with `tissueid calibrate-frame`"
    try:
        content = file.read_bytes()
        document = json.loads(content)
    except (OSError, ValueError) as error:
        message = f"this is not a frame file ({error}); {way_out}"
        raise InputError(code="invalid_frame", message=message, path=str(file)) from error
    problem = first_problem(document, "frame")
    if problem is not None:
        raise InputError(code="invalid_frame", message=f"{problem}; {way_out}", path=str(file))
    force = np.array(document["force_N"])
    compliance = np.array(document["compliance_mm_per_N"])
    knots = force.size
    square = all(len(row) == knots for row in document["covariance"]) and len(document["covariance"]) == knots
    if compliance.size != knots or not square or force[0] != 0.0 or (np.diff(force) <= 0.0).any():
        message = f"its knots do not belong together (forces grow from 0, one compliance each); {way_out}"
        raise InputError(code="invalid_frame", message=message, path=str(file))
    low, high = document["range_N"]
    return FrameCurve(
        force,
        compliance,
        np.array(document["covariance"]),
        range_N=(float(low), float(high)),
        path=str(file),
        sha256=hashlib.sha256(content).hexdigest(),
        sources=tuple(source["sha256"] for source in document["sources"]),
    )
