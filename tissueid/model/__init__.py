"""Contact models: pure functions and frozen objects that identification and rendering share."""

from __future__ import annotations

from tissueid.model.base import (
    ContactModel,
    ContactPath,
    ParameterSpec,
    Stepper,
    build_model,
    model_keys,
)
from tissueid.model.impact import HertzImpact
from tissueid.model.kelvin_voigt import KelvinVoigt

__all__ = [
    "ContactModel",
    "ContactPath",
    "HertzImpact",
    "KelvinVoigt",
    "ParameterSpec",
    "Stepper",
    "build_model",
    "model_keys",
]
