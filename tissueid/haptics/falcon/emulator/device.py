"""The driver of a Falcon, on an emulated one in a process of its own: ``--device emulator``."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from tissueid.errors import refuse
from tissueid.haptics.device import AskedDevice, Capabilities, DetectedDevice
from tissueid.haptics.falcon.calibration import Calibration
from tissueid.haptics.falcon.device import FalconDevice
from tissueid.haptics.falcon.emulator.links import EmulatorProcess
from tissueid.haptics.limits import GuardLimits


class EmulatorDevice(FalconDevice):
    """A Falcon driver on an emulator with its own ``arguments``; UsageError where a port was named."""

    name = "emulator"
    refuses = ("port",)
    #: None but what the driver assumes: the user's is of a real device.
    own_calibration = staticmethod(Calibration)

    def __init__(
        self,
        limits: GuardLimits | None = None,
        *,
        arguments: Sequence[str] = ("--sweep",),
        port: str | None = None,
        firmware: str | os.PathLike[str] | None = None,
        calibration: Calibration | None = None,
    ) -> None:
        if port is not None:
            refuse(f"--device emulator makes its own port; for one that runs at {port} say --device falcon")
        super().__init__(limits, port="", firmware=firmware, calibration=calibration or Calibration())
        self._arguments = tuple(arguments)
        self._process: EmulatorProcess | None = None

    @classmethod
    def configured(cls, asked: AskedDevice) -> dict[str, Any]:
        """As of a real one, without a time-out of homing; a grip that must be free is let go of."""
        found = super().configured(replace(asked, homing_timeout_s=None))
        # a hand on the grip would be measured with it
        return found | {"arguments": ("--free",)} if asked.hands_off else found

    def keeps(self, file: Path | None) -> bool:
        """Only in a file that was named."""
        return file is not None

    @classmethod
    def detect(cls) -> list[DetectedDevice]:
        """It is always there."""
        return [DetectedDevice(cls.name, "a process of this program")]

    @property
    def capabilities(self) -> Capabilities:
        """Those of the driver; no motor moves."""
        return replace(super().capabilities, hardware=False)

    def _open(self) -> None:
        self._process = EmulatorProcess(self._arguments)
        self._port = self._process.path
        super()._open()

    def _close(self) -> None:
        super()._close()
        process, self._process = self._process, None
        if process is not None:
            process.close()
