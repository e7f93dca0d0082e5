"""Contact models: pure functions and frozen objects that identification and rendering share.

Loaded on first use: a first look at a recording needs a tip's formula and no compiled law.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

__all__ = [
    "ContactModel",
    "ContactPath",
    "KelvinVoigt",
    "ParameterSpec",
    "Stepper",
]

if TYPE_CHECKING:
    from tissueid.model.base import (
        ContactModel,
        ContactPath,
        ParameterSpec,
        Stepper,
    )
    from tissueid.model.kelvin_voigt import KelvinVoigt


def __getattr__(name: str) -> Any:
    if name in __all__:
        from tissueid.model import base, kelvin_voigt

        return getattr(kelvin_voigt if name == "KelvinVoigt" else base, name)
    msg = f"module 'tissueid.model' has no attribute {name!r}"
    raise AttributeError(msg)
