"""Devices by the Force Dimension SDK, which the user installs; its driver carries the Falcon's firmware."""

from tissueid.haptics.forcedimension.device import ForceDimensionDevice

__all__ = ["ForceDimensionDevice"]
