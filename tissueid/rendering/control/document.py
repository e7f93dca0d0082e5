"""Document of ``tissueid control``, as plain data (schemas/control.schema.json); measures of loops."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import astuple
from typing import Any

import msgspec
import numpy as np

from tissueid.documents.control import Measures
from tissueid.rendering.control.settings import (
    MARGIN,
    TABLE_3_DEVICE,
    TABLE_3_OPERATOR,
    TASKS,
    ControlSettings,
    Mechanics,
    virtual_mass_bound,
)
from tissueid.rendering.control.simulation import ControlRun

#: Errors are taken over the last seconds of a run, when the push has risen.
LAST_S = 5.0


def measured(run: ControlRun) -> Measures:
    """Measures of a run: where it diverged, of the time before.

    An impedance-type controller leads by velocity alone: its error of position means nothing.
    """
    settings = run.settings
    over = min(LAST_S, 0.5 * settings.seconds)
    late = run.time_s >= run.time_s[-1] - over
    error = run.error_mm[late]
    speed = 1e3 * np.linalg.norm(run.tool_velocity_m_s - run.velocity_m_s, axis=1)[late]
    touching = run.position_m if settings.environment == "impedance" else run.tool_position_m
    depth = 1e3 * touching[:, 0] / settings.motion_scale
    control = np.linalg.norm(run.control_force_N, axis=1)
    limit = settings.gains.saturation_N
    # by how much V rose after each row beyond (I-6) [W]
    rho = np.sum(run.rho_m_s**2, axis=1)
    allowed = (-settings.gains.damping_N_s_per_m * rho + run.sigma)[:-1]
    excess = np.diff(run.lyapunov) / np.diff(run.time_s) - allowed
    return Measures(
        diverged_s=run.diverged_s,
        over_s=over,
        error_rms_mm=float(np.sqrt(np.mean(error**2))),
        error_max_mm=float(error.max()),
        velocity_error_rms_mm_s=float(np.sqrt(np.mean(speed**2))),
        deepest_mm=float(depth.max()),
        outside_share=float(np.mean(depth > settings.tissue.model.depth_mm)),
        environment_force_max_N=float(run.environment_force_N.max()),
        control_force_max_N=float(control.max()),
        # a force that was shortened to the limit is that long but for rounding
        saturated_share=float(np.mean(control >= limit * (1.0 - 1e-9))) if math.isfinite(limit) else 0.0,
        lyapunov_start=float(run.lyapunov[0]),
        lyapunov_max=float(run.lyapunov.max()),
        lyapunov_end=float(run.lyapunov[-1]),
        violated_share=float(np.mean(excess > 0.0)) if excess.size else 0.0,
        violation_max_W=max(0.0, float(excess.max())) if excess.size else 0.0,
    )


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
    own = all(map(np.array_equal, found.parts(), table.parts()))
    kind, source = ("reading", TABLE_3) if own else ("stated", STATED)
    return [
        _row(f"{who} {name}", float(part[0, 0]), unit, kind, source)
        for (name, unit), part in zip(names.items(), found.parts(), strict=True)
    ]


def settings_table(settings: ControlSettings) -> list[dict[str, Any]]:
    """Every number of a loop of one axis: unit, kind (reading, derived, assumed or stated) and source."""
    default = ControlSettings(settings.tissue, variant=settings.variant)
    gains, plain = settings.gains, default.gains

    def chosen(name: str, value: float | None, usual: float | None, unit: str) -> dict[str, Any]:
        kind = "assumed" if value == usual else "stated"
        return _row(name, value, unit, kind, ASSUMED if value == usual else STATED)

    push = settings.push or settings.task("sustained").push
    assert push is not None  # noqa: S101 -- a task has one
    (offset,), (amplitude,), (frequency,) = astuple(push)
    usual = (offset, amplitude, frequency) in TASKS.values()
    said = f"{offset:g} + {amplitude:g} sin(2 pi {frequency:g} t)"
    hand = ("assumed", ASSUMED) if usual else ("stated", STATED)
    floor = "derived" if gains.sigma_floor is None else "stated"
    return [
        *_mechanics("operator", settings.operator, TABLE_3_OPERATOR),
        *_mechanics("device", settings.device, TABLE_3_DEVICE),
        chosen("virtual mass", settings.tool.mass_kg, default.tool.mass_kg, "kg"),
        chosen("virtual damping", settings.tool.damping_N_s_per_m, 0.0, "N s/m"),
        _row("push of the hand F*", said, "N", *hand),
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
    # several axes are for Python: the command's loops have one
    low, high = settings.estimate_bounds()
    columns = np.stack([run.estimates[0], run.estimates[-1], settings.estimated_truth(), low, high], axis=1)
    names = ("mass_kg", "damping_N_s_per_m", "stiffness_N_per_m")
    return {
        "name": name,
        "adapts": settings.gains.adaptation_sign != 0,
        "stiffness_scale": settings.stiffness_scale,
        "measures": msgspec.structs.asdict(measured(run)),
        "estimates": [
            {"name": label, **dict(zip(("start", "end", "true", "low", "high"), row, strict=True))}
            for label, row in zip(names, columns.tolist(), strict=True)
        ],
    }


def as_document(
    runs: Mapping[str, ControlRun], *, source: str, device: Mapping[str, float] | None = None
) -> dict[str, Any]:
    """The document of ``schemas/control.schema.json`` on runs of one axis, the asked for one first."""
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
