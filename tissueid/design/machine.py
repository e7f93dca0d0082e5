"""Abilities of a test machine: speeds, acceleration, force, and the settings of its load channel.

::

    name = "our machine"
    max_speed_mm_min = 500.0
    acceleration_mm_s2 = 200.0
    max_force_N = 100.0                   # load cell
    frame_stiffness_N_per_mm = 900.0      # left out: taken as rigid
    [[setting]]
    rate_Hz = 1000.0
    noise_N = 0.2                         # standard deviation of one sample, with this filter
    noise_correlation_s = 0.0             # 0 is white
    filter_s = 0.0                        # time constant of the force channel's low-pass

Presets are examples with assumed numbers, and no vendor's data.
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

from tissueid.errors import InputError, refuse
from tissueid.priors import CALIBRATION_DEFAULTS

#: Calibration nuisances of a total precision, in the order of their columns.
CALIBRATION = tuple(CALIBRATION_DEFAULTS)
#: Standard deviation of a stated filter or frame compliance whose own is not stated, as a share.
UNSTATED_SHARE = 0.10


@dataclass(frozen=True, slots=True)
class Setting:
    """One setting of the load channel."""

    rate_Hz: float
    noise_N: float  # standard deviation of the noise of one sample, as logged with this setting
    noise_correlation_s: float = 0.0  # time over which its correlation falls to 1/e (AR(1)); 0 is white
    filter_s: float = 0.0  # time constant of a first-order low-pass
    #: How well that is known; ``None`` is a tenth of it, or the documented default where it is 0.
    filter_sd_s: float | None = None

    @property
    def step_s(self) -> float:
        """Sampling interval."""
        return 1.0 / self.rate_Hz

    @property
    def phi(self) -> float:
        """Correlation of neighbouring samples."""
        correlated = self.noise_correlation_s > 0.0
        return math.exp(-self.step_s / self.noise_correlation_s) if correlated else 0.0

    @property
    def words(self) -> str:
        """In a few words."""
        noise = f"noise {self.noise_N:g} N"
        if self.noise_correlation_s > 0.0:
            noise += f" correlated over {self.noise_correlation_s:g} s"
        low_pass = f", filter {self.filter_s:g} s" if self.filter_s > 0.0 else ""
        return f"{self.rate_Hz:g} Hz{low_pass}, {noise}"


@dataclass(frozen=True, slots=True)
class Machine:
    """A test machine."""

    name: str
    max_speed_mm_min: float
    acceleration_mm_s2: float
    max_force_N: float  # capacity of the load cell
    settings: tuple[Setting, ...]  # what the load channel can be set to
    min_speed_mm_min: float = 1.0
    standoff_mm: float = 1.0  # way from which the tool comes through the air: on it, it gathers speed
    return_speed_mm_min: float | None = None  # ``None`` is the greatest
    contact_sd_mm: float = 0.01  # how well the contact point of a log is found
    #: Machine, load cell and fixture in series; ``None`` is taken as rigid.
    frame_stiffness_N_per_mm: float | None = None
    frame_stiffness_N_per_mm_sd: float | None = None
    #: For the total precision.
    force_gain_sd: float = CALIBRATION_DEFAULTS["force_gain"].sd
    displacement_gain_sd: float = CALIBRATION_DEFAULTS["displacement_gain"].sd
    skew_sd_s: float = CALIBRATION_DEFAULTS["skew_s"].sd
    notes: str = ""

    @property
    def compliance_mm_per_N(self) -> float:
        """Of the frame; 0 where it is taken as rigid."""
        return 0.0 if self.frame_stiffness_N_per_mm is None else 1.0 / self.frame_stiffness_N_per_mm

    def calibration_sd(self, setting: Setting) -> dict[str, float]:
        """Prior standard deviation of each calibration nuisance."""
        low_pass = setting.filter_sd_s
        if low_pass is None:
            default = CALIBRATION_DEFAULTS["force_filter_s"].sd
            low_pass = UNSTATED_SHARE * setting.filter_s if setting.filter_s > 0.0 else default
        give = CALIBRATION_DEFAULTS["frame_compliance_mm_per_N"].sd
        if self.frame_stiffness_N_per_mm is not None:
            sd = self.frame_stiffness_N_per_mm_sd
            share = UNSTATED_SHARE if sd is None else sd / self.frame_stiffness_N_per_mm
            give = share * self.compliance_mm_per_N
        values = (self.force_gain_sd, self.displacement_gain_sd, self.skew_sd_s, low_pass, give)
        return dict(zip(CALIBRATION, values, strict=True))


_ZERO_ALLOWED = {
    "noise_correlation_s", "filter_s", "filter_sd_s", "standoff_mm", "force_gain_sd", "displacement_gain_sd",
    "skew_sd_s", "frame_stiffness_N_per_mm_sd",
}  # fmt: skip
_TEXT = {"name", "notes"}


def _refuse(path: str, message: str) -> InputError:
    return InputError(code="machine", message=message, path=path)


def _checked(table: Mapping[str, Any], cls: type, path: str, where: str) -> dict[str, Any]:
    """Known keys with numbers that make sense."""
    known = {field.name: field for field in fields(cls)}
    values = {key: value for key, value in table.items() if key not in {"setting", "settings"}}
    for key, value in values.items():
        if key not in known:
            names = ", ".join(name for name in known if name != "settings")
            raise _refuse(path, f"{where}unknown key {key!r}; known are {names}")
        if key in _TEXT:
            if not isinstance(value, str):
                raise _refuse(path, f"{where}{key} = {value!r} must be text in quotes")
            continue
        number = isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
        if not number or value < 0.0 or (value == 0.0 and key not in _ZERO_ALLOWED):
            least = "at least 0" if key in _ZERO_ALLOWED else "above 0"
            raise _refuse(path, f"{where}{key} = {value!r} must be a number {least}")
        values[key] = float(value)
    return values


def _load(path: Path) -> Machine:
    name = str(path)
    try:
        table = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        message = f"can't be read ({error.strerror}); give a machine.toml, or one of {', '.join(PRESETS)}"
        raise _refuse(name, message) from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise _refuse(name, f"is not TOML: {error}") from error
    entries = table.get("setting", [])
    if not isinstance(entries, list) or not entries or not all(isinstance(one, dict) for one in entries):
        message = "says nothing of the load channel: add a table [[setting]] with rate_Hz and noise_N"
        raise _refuse(name, message)
    values = _checked(table, Machine, name, "")
    for key in ("max_speed_mm_min", "acceleration_mm_s2", "max_force_N"):
        if key not in values:
            raise _refuse(name, f"{key} is missing: a protocol can't be planned without it, add {key} = ...")
    settings = []
    for number, entry in enumerate(entries, start=1):
        one = _checked(entry, Setting, name, f"[[setting]] {number}: ")
        for key in ("rate_Hz", "noise_N"):
            if key not in one:
                raise _refuse(
                    name, f"[[setting]] {number}: {key} is missing: measure it, and add {key} = ..."
                )
        settings.append(Setting(**one))
    machine = Machine(**{"name": path.stem, **values}, settings=tuple(settings))
    if machine.min_speed_mm_min > machine.max_speed_mm_min:
        slow, fast = machine.min_speed_mm_min, machine.max_speed_mm_min
        raise _refuse(name, f"min_speed_mm_min = {slow:g} is above max_speed_mm_min = {fast:g}")
    return machine


_BENCH = Machine(
    name="bench",
    max_speed_mm_min=1000.0,
    min_speed_mm_min=0.1,
    acceleration_mm_s2=200.0,
    max_force_N=500.0,
    settings=(Setting(1000.0, 0.2), Setting(100.0, 0.1, noise_correlation_s=0.01, filter_s=0.01)),
    frame_stiffness_N_per_mm=2000.0,
    notes="assumed: a small electromechanical machine that accelerates within 0.1 s",
)
#: Machines by name. Numbers are assumed, of no vendor.
PRESETS: Mapping[str, Machine] = {
    "paper-a": Machine(
        name="paper-a",
        max_speed_mm_min=500.0,
        min_speed_mm_min=10.0,
        acceleration_mm_s2=1000.0,
        max_force_N=500.0,
        settings=(Setting(1000.0, 1.0), Setting(100.0, 1.0)),
        notes=(
            "speeds of paper A; its sampling rate, noise, load cell and acceleration are not printed and "
            "assumed here, as in the synthetic protocols of its name"
        ),
    ),
    "bench": _BENCH,
    "texture-analyser": Machine(
        name="texture-analyser",
        max_speed_mm_min=2400.0,
        min_speed_mm_min=0.6,
        acceleration_mm_s2=500.0,
        max_force_N=50.0,
        settings=(Setting(500.0, 0.01),),
        frame_stiffness_N_per_mm=500.0,
        notes="assumed: a fast bench-top machine with a light load cell",
    ),
    "slow-logger": replace(
        _BENCH,
        name="slow-logger",
        max_speed_mm_min=50.0,
        settings=(Setting(10.0, 1.0, noise_correlation_s=0.1, filter_s=0.1),),
        notes="assumed: a machine whose display is logged, ten samples a second behind a slow filter",
    ),
}


def found_machine(named: str | None) -> Machine:
    """The machine of a preset or a file."""
    names = ", ".join(PRESETS)
    if named is None:
        refuse(f"which machine? give --machine machine.toml, or one of {names} (docs/design.md)")
    if named in PRESETS:
        return PRESETS[named]
    if not Path(named).is_file():
        refuse(f"--machine {named}: no such file or preset; presets are {names}")
    return _load(Path(named))
