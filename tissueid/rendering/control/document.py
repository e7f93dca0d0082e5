"""Document of ``tissueid control``, as plain data (schemas/control.schema.json)."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

import numpy as np

from tissueid.rendering.control.measures import measured
from tissueid.rendering.control.mechanics import TABLE_3_DEVICE, TABLE_3_OPERATOR, TASKS, Mechanics
from tissueid.rendering.control.settings import ControlSettings
from tissueid.rendering.control.simulation import ControlRun
from tissueid.rendering.control.virtual_mass import MARGIN, virtual_mass_bound

SCHEMA = "tissueid/control/1"

TABLE_3 = "Sadeghnejad et al., Table 3; which number is which, and the units, are a reading"
STATED = "stated by the user"
ASSUMED = "assumed"


def _row(name: str, value: float | str | None, unit: str, kind: str, source: str) -> dict[str, Any]:
    finite = value if not isinstance(value, float) or math.isfinite(value) else None
    return {"name": name, "value": finite, "unit": unit, "kind": kind, "source": source}


def _mechanics(who: str, found: Mechanics, table: Mechanics) -> list[dict[str, Any]]:
    """Three rows of a body of one axis: from the paper's table as it was read, or stated."""
    names = {"mass": "kg", "damping": "N s/m", "stiffness": "N/m"}
    own = all(map(np.array_equal, _parts(found), _parts(table)))
    kind, source = ("reading", TABLE_3) if own else ("stated", STATED)
    return [
        _row(f"{who} {name}", float(part[0, 0]), unit, kind, source)
        for (name, unit), part in zip(names.items(), _parts(found), strict=True)
    ]


def _parts(one: Mechanics) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    return one.mass_kg, one.damping_N_s_per_m, one.stiffness_N_per_m


def settings_table(settings: ControlSettings) -> list[dict[str, Any]]:
    """Every number of a loop of one axis with its unit, its kind and its source.

    Kinds: reading (a published number whose meaning was lost), derived, assumed, stated.
    """
    default = ControlSettings(settings.tissue, variant=settings.variant)
    gains, plain = settings.gains, default.gains

    def chosen(name: str, value: float | None, usual: float | None, unit: str) -> dict[str, Any]:
        kind = "assumed" if value == usual else "stated"
        return _row(name, value, unit, kind, ASSUMED if value == usual else STATED)

    push = settings.push or settings.task("sustained").push
    assert push is not None  # noqa: S101 -- a task has one
    usual = (push.offset_N[0], push.amplitude_N[0], push.frequency_Hz[0]) in TASKS.values()
    said = f"{push.offset_N[0]:g} + {push.amplitude_N[0]:g} sin(2 pi {push.frequency_Hz[0]:g} t)"
    floor = "derived" if gains.sigma_floor is None else "stated"
    return [
        *_mechanics("operator", settings.operator, TABLE_3_OPERATOR),
        *_mechanics("device", settings.device, TABLE_3_DEVICE),
        chosen("virtual mass", settings.tool.mass_kg, default.tool.mass_kg, "kg"),
        chosen("virtual damping", settings.tool.damping_N_s_per_m, 0.0, "N s/m"),
        _row(
            "push of the hand F*", said, "N", "assumed" if usual else "stated", ASSUMED if usual else STATED
        ),
        chosen("Lambda", gains.reference_rate_per_s, plain.reference_rate_per_s, "1/s"),
        chosen("K_r", gains.damping_N_s_per_m, plain.damping_N_s_per_m, "N s/m"),
        chosen("delta", settings.disturbance_bound_N(), default.disturbance_bound_N(), "N"),
        chosen("sigma at the start", gains.sigma_start, plain.sigma_start, "N m/s"),
        chosen("sigma's rate", gains.sigma_rate_per_s, plain.sigma_rate_per_s, "1/s"),
        _row("sigma's floor", settings.sigma_floor(), "N m/s", floor, "three times the chatter floor"),
        *(
            chosen(f"Gamma of {name}", value, usual_gain, "")
            for name, value, usual_gain in zip(
                ("mass", "damping", "stiffness"), gains.adaptation, plain.adaptation, strict=True
            )
        ),
        chosen("saturation", gains.saturation_N, plain.saturation_N, "N"),
        chosen("rate of the controller", settings.rate_Hz, default.rate_Hz, "Hz"),
        _row("sub-steps of the tool", settings.tool_substeps(), "", "derived", "from the tissue's stiffness"),
    ]


def _run(name: str, run: ControlRun) -> dict[str, Any]:
    settings = run.settings
    bounds = settings.estimate_bounds()
    # arms and several axes are for Python: the command's loops have one axis
    estimates = zip(("mass_kg", "damping_N_s_per_m", "stiffness_N_per_m"), range(3), strict=True)
    truth = settings.estimated_truth()
    return {
        "name": name,
        "adapts": settings.gains.adaptation_sign != 0,
        "stiffness_scale": settings.stiffness_scale,
        "measures": asdict(measured(run)),
        "estimates": [
            {
                "name": label,
                "start": float(run.estimates[0, k]),
                "end": float(run.estimates[-1, k]),
                "true": float(truth[k]),
                "low": float(bounds[0, k]),
                "high": float(bounds[1, k]),
            }
            for label, k in estimates
        ],
    }


def as_document(
    runs: Mapping[str, ControlRun], *, source: str, device: Mapping[str, float] | None = None
) -> dict[str, Any]:
    """The document of ``schemas/control.schema.json``.

    ``runs``: name -> run of one axis; the first is what was asked for; ``source``: where the tissue is from;
    ``device``: what a device run said of itself.
    """
    settings = next(iter(runs.values())).settings
    bound = virtual_mass_bound(settings)
    low, high = settings.tissue.speeds_mm_s
    return {
        "schema": SCHEMA,
        "tissue": {
            "name": settings.tissue.name,
            "source": source,
            "depth_mm": settings.tissue.model.depth_mm,
            "speeds_mm_s": [low, high],
        },
        "variant": settings.variant,
        "environment": settings.environment,
        "stiffness_scale": settings.stiffness_scale,
        "projection": settings.gains.projection,
        "seconds": settings.seconds,
        "virtual_mass": {
            "given_kg": settings.tool.mass_kg,
            "bound_kg": bound,
            "enough": settings.tool.mass_kg >= MARGIN * bound,
        },
        "chatter": {"floor": settings.chatter_floor(), "used": settings.sigma_floor()},
        "numbers": settings_table(settings),
        "runs": [_run(name, run) for name, run in runs.items()],
        "device": None if device is None else dict(device),
    }
