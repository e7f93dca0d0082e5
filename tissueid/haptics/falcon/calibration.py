"""Measurements of a user's own Falcon, in one small file of the user's configuration directory."""

from __future__ import annotations

import math
import os
import sys
import tomllib
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import Any

from tissueid.errors import DeviceError
from tissueid.haptics.falcon.kinematics import GEOMETRIES, Geometry
from tissueid.haptics.falcon.packets import MOTOR_LIMIT
from tissueid.haptics.limits import UNCALIBRATED_N, WORST_UNITS_PER_NM, uncalibrated_clamp_N

#: Motor units per N m: this reproduces the vendor's "more than 8.9 N"; reports range from 3460 to 10 000.
UNITS_PER_NM = 6600.0
#: Largest force of a calibrated device [N], and of one whose checklist nobody has gone through.
CALIBRATED_CLAMP_N = 8.0
UNCONFIRMED_CLAMP_N = 2.0
#: Largest arm torque that one newton needs anywhere in the working sphere, a radius of 40 mm about
#: (0, 0, 0.130), in both geometries [m].
LONGEST_ARM_M = 0.0921
#: Torques of the three arms, as the root of the sum of their squares, that one newton in the direction that
#: takes most of them needs in the middle of the workspace, (0, 0, 0.120) [m].
SPAN_M = 0.0735
#: Ranges of the numbers: outside, the file is refused.
RANGES = {
    "zero_angle_deg": (20.0, 65.0),
    "units_per_Nm": (1000.0, 30_000.0),
    "damping_N_s_per_m": (0.0, 20.0),
    "delay_ticks": (0.0, 10.0),
    "weight_N": (-4.0, 4.0),
    "weight_slope_N_per_m": (-50.0, 50.0),
}
HEADER = (
    "# Calibration of a Novint Falcon, written by tissueid devices. Delete it to go back to the presets.\n"
)


@dataclass(frozen=True)
class Calibration:
    """Numbers of one Falcon; the defaults are assumptions."""

    geometry: str = "stamper"  # key of :data:`~tissueid.haptics.falcon.kinematics.GEOMETRIES`
    zero_angle_deg: float = 35.0  # leg angle at count zero
    units_per_Nm: float = UNITS_PER_NM  # motor units for one N m of arm torque
    force_calibrated: bool = False  # whether ``units_per_Nm`` was weighed on this device
    #: Viscous damping of the device itself, which bounds the stiffness it can render.
    damping_N_s_per_m: float = 0.5
    damping_measured: bool = False
    delay_ticks: float = 1.5  # from a command to its effect on the next position, in ticks of the servo
    delay_measured: bool = False
    confirmed: bool = False  # whether the hardware checklist was passed on this machine
    weight_N: tuple[float, ...] = (0.0, 0.0, 0.0)  # force that holds the grip in the middle of the workspace
    #: Its change with the position, nine numbers, row by row of the force's components.
    weight_slope_N_per_m: tuple[float, ...] = (0.0,) * 9
    weight_measured: bool = False

    @property
    def clamp_N(self) -> float:
        """Largest force the guard lets pass, as computed with :attr:`units_per_Nm` [nominal N]."""
        clamp = CALIBRATED_CLAMP_N if self.force_calibrated else uncalibrated_clamp_N(self.units_per_Nm)
        return clamp if self.confirmed else min(UNCONFIRMED_CLAMP_N, clamp)

    @property
    def clamp_units(self) -> int:
        """Largest root of the sum of squares of the three motors' commands [motor units].

        What the clamp needs in the middle of the workspace: there a pose that is believed wrongly makes less
        than twice the clamp of it.  Of an uncalibrated constant, no more than the worst known turns into 5 N.
        """
        most = MOTOR_LIMIT if self.force_calibrated else LONGEST_ARM_M * UNCALIBRATED_N * WORST_UNITS_PER_NM
        return math.floor(min(most, MOTOR_LIMIT, SPAN_M * self.clamp_N * self.units_per_Nm))

    def legs(self) -> Geometry:
        """The geometry with the calibrated zero angle."""
        return replace(GEOMETRIES[self.geometry], zero_angle_deg=self.zero_angle_deg)


def calibration_path() -> Path:
    """The file, in the configuration directory of the platform; it need not exist."""
    if sys.platform == "win32":
        base = Path(os.environ.get("APPDATA") or Path.home() / "AppData" / "Roaming")
    elif sys.platform == "darwin":
        base = Path.home() / "Library" / "Application Support"
    else:
        base = Path(os.environ.get("XDG_CONFIG_HOME") or Path.home() / ".config")
    return base / "tissueid" / "falcon.toml"


def load_calibration(path: Path | None = None) -> Calibration:
    """The user's calibration, or the assumptions without a file; DeviceError: a wrong one is not replaced."""
    path = calibration_path() if path is None else path
    try:
        text = path.read_text(encoding="utf-8")
    except FileNotFoundError:
        return Calibration()
    except (OSError, UnicodeDecodeError) as error:
        raise _refusal(path, f"can't be read ({error})") from error
    try:
        document = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise _refusal(path, f"is no TOML: {error}") from error
    known = {field.name: field.default for field in fields(Calibration)}
    for key, value in document.items():
        if key not in known:
            raise _refusal(path, f"has an unknown key {key!r}; known are {', '.join(known)}")
        document[key] = _checked(path, key, value, known[key])
    return Calibration(**document)


def save_calibration(calibration: Calibration, path: Path | None = None) -> Path:
    """Write the file whole or not at all; its path, or DeviceError for what would not be loaded again."""
    import tomlkit

    from tissueid.store.files import write_file

    path = calibration_path() if path is None else path
    kept: dict[str, Any] = {}
    for key, value in asdict(calibration).items():
        try:
            kept[key] = _checked(path, key, value, getattr(Calibration, key))
        except DeviceError as error:
            low, high = RANGES.get(key, (None, None))
            msg = f"not kept: {key} = {value!r} is not from {low} to {high}; measure again"
            raise DeviceError(msg) from error
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_file(path, (HEADER + tomlkit.dumps(kept)).encode("utf-8"))
    except OSError as error:
        msg = f"{path}: the calibration can't be written ({error.strerror}); set XDG_CONFIG_HOME to a folder"
        raise DeviceError(msg) from error
    return path


def _checked(path: Path, key: str, value: object, default: object) -> Any:
    """A value of the right type and in range."""
    if isinstance(default, bool):
        if not isinstance(value, bool):
            raise _refusal(path, f"has {key} = {value!r}, which is neither true nor false")
        return value
    if isinstance(default, str):
        if value not in GEOMETRIES:
            raise _refusal(path, f"has {key} = {value!r}; known are {', '.join(GEOMETRIES)}")
        return value
    low, high = RANGES[key]
    if isinstance(default, tuple):
        if not isinstance(value, (list, tuple)) or len(value) != len(default):
            raise _refusal(path, f"has {key} = {value!r}, which are not {len(default)} numbers")
        return tuple(_number(path, key, one, low, high) for one in value)
    return _number(path, key, value, low, high)


def _number(path: Path, key: str, value: object, low: float, high: float) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not low <= value <= high:
        raise _refusal(path, f"has {key} = {value!r}, which is no number from {low:g} to {high:g}")
    return float(value)


def _refusal(path: Path, what: str) -> DeviceError:
    return DeviceError(f"the calibration {path} {what}. Correct it, or delete it to go back to the presets")
