"""Devices and force laws by name: a lazy table, and what other distributions add."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import Any, NamedTuple

from tissueid.errors import DeviceError, UsageError, refuse
from tissueid.haptics.device import AskedDevice, Capabilities, DetectedDevice, HapticDevice

#: Entry-point groups of other distributions.
DEVICE_GROUP = "tissueid.devices"
ENVIRONMENT_GROUP = "tissueid.environments"


class Registered(NamedTuple):
    """Place of a driver, ``module:class``, imported when asked for."""

    place: str
    hardware: bool = False
    #: Words of a report that speaks of this kind of device; empty for one that it does not speak of.
    reported_as: str = ""


#: name -> driver, hardware in the order in which ``auto`` looks for it.
DEVICES = {
    "falcon": Registered(
        "tissueid.haptics.falcon.device:FalconDevice",
        hardware=True,
        reported_as="Novint Falcon, uncalibrated",
    ),
    "forcedimension": Registered(
        "tissueid.haptics.forcedimension.device:ForceDimensionDevice", hardware=True
    ),
    "emulator": Registered("tissueid.haptics.falcon.emulator.device:EmulatorDevice"),
    "replay": Registered("tissueid.haptics.sim:ReplayDevice"),
    "sim": Registered("tissueid.haptics.sim:SimulatedDevice", reported_as="Simulated device"),
}
HARDWARE = tuple(name for name, one in DEVICES.items() if one.hardware)
AUTO = "auto"


@dataclass(frozen=True, slots=True)
class Choice:
    """Device that ``auto`` or the user took."""

    name: str
    why: str  # one sentence for the console and the log


def _plugins() -> dict[str, EntryPoint]:
    """Devices of other distributions by name; a built-in name is not given away."""
    return {entry.name: entry for entry in entry_points(group=DEVICE_GROUP) if entry.name not in DEVICES}


def device_names() -> list[str]:
    """Every device that can be named, built in first."""
    return [*DEVICES, *sorted(_plugins())]


def _loaded(kind: str, name: str, load: Callable[[], Any]) -> Any:
    """Import what a name stands for, with the plug-in's own failure as the reason."""
    try:
        return load()
    # a plug-in may fail in any way while it is imported, and its author needs to read how
    except Exception as error:
        raise DeviceError(
            f"{kind} {name!r} is installed but can't be loaded ({type(error).__name__}: {error}); "
            "repair or remove the distribution that provides it"
        ) from error


def device_class(name: str) -> type[HapticDevice]:
    """The class behind a name; UsageError if there is none, DeviceError for a plug-in that fails."""
    if name in DEVICES:
        module, _, attribute = DEVICES[name].place.partition(":")
        found = getattr(importlib.import_module(module), attribute)
    else:
        entry = _plugins().get(name)
        if entry is None:
            refuse(f"no device named {name!r}; there are {', '.join(device_names())} and {AUTO}")
        found = _loaded("device", name, entry.load)
    if not (isinstance(found, type) and issubclass(found, HapticDevice)):
        msg = f"device {name!r}: its entry point is no subclass of tissueid.haptics.device.HapticDevice"
        raise DeviceError(msg)
    return found


def owners_of(option: str) -> list[str]:
    """Built-in devices whose driver takes an option of the command line, and does something with it."""
    found = {name: device_class(name) for name in DEVICES}
    return [name for name, one in found.items() if option in one.takes and option not in one.refuses]


def configured(name: str, asked: AskedDevice) -> dict[str, Any]:
    """Arguments of a device's class for what was asked; UsageError for an option of another device."""
    taken = () if name == AUTO else device_class(name).takes
    # options that not every device has
    for strange in ("port", "firmware", "calibration"):
        if getattr(asked, strange) is None or strange in taken:
            continue
        owners = owners_of(strange)
        way = f"add --device {owners[0]}" if name == AUTO else f"the device is {name}"
        refuse(f"--{strange} belongs to {' and '.join(owners)}: {way}")
    return {} if name == AUTO else device_class(name).configured(asked)


def reported_devices() -> dict[str, Capabilities]:
    """Kinds of devices that a report speaks of, in its words, and their abilities uncalibrated."""
    return {one.reported_as: device_class(name).typical() for name, one in DEVICES.items() if one.reported_as}


def environment_law(name: str) -> Callable[..., Any]:
    """The force law that another distribution registered; UsageError, or DeviceError where it fails."""
    laws = entry_points(group=ENVIRONMENT_GROUP)
    for entry in laws.select(name=name):
        law = _loaded("force law", name, entry.load)
        if not callable(law):
            raise DeviceError(f"force law {name!r}: its entry point is {type(law).__name__}, not a function")
        return law  # type: ignore[no-any-return]
    there = ", ".join(sorted(laws.names)) or "none"
    msg = f"no force law named {name!r}; installed: {there} (entry-point group {ENVIRONMENT_GROUP})"
    raise UsageError(msg)


def detect_all(names: Iterable[str] | None = None) -> Iterator[DetectedDevice]:
    """Devices found, of these names or all, and what stands in their way; none that fails hides another."""
    for name in device_names() if names is None else names:
        try:
            found = device_class(name).detect()
        except DeviceError as error:
            found = [DetectedDevice(name, "this program", error.message)]
        yield from found


def choose_device(name: str = AUTO) -> Choice:
    """The device a name stands for; of ``auto`` the first hardware with nothing in its way, else ``sim``."""
    if name != AUTO:
        device_class(name)
        return Choice(name, f"device {name}: asked for by name")
    hindered = []
    for found in detect_all((*HARDWARE, *sorted(_plugins()))):
        if not found.note:
            return Choice(found.name, f"device {found.name}: found at {found.where}")
        hindered.append(f"{found.name} at {found.where}: {found.note}")
    why = "; ".join(hindered) or "no haptic device was found"
    return Choice("sim", f"device sim, simulated: {why}")


def check_present(name: str, port: object = None) -> None:
    """Refuse, with the way out, hardware that is missing or hindered, before anybody is asked anything."""
    if port is not None:
        if isinstance(port, str) and port.startswith("/") and not Path(port).exists():
            raise DeviceError(f"{port}: there is no such device; is it plugged in, or the emulator running?")
        return
    if name not in HARDWARE:
        return
    found = device_class(name).detect()
    if not found:
        raise DeviceError(f"no {name} was found on this machine; plug it in and see `tissueid devices list`")
    if all(one.note for one in found):
        raise DeviceError("; ".join(f"{name} at {one.where}: {one.note}" for one in found))
