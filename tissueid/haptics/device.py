"""A device that can be felt: what a backend writes, and what it can't get round.

A backend overrides ``detect``, ``capabilities``, ``_open``, ``_close``, ``_read`` and ``_write``; the others
are final: every force goes through :func:`tissueid.haptics.guard.guard`, every way out sends zero force.
SI units.  Frame: x right, y up, z out toward the user, origin on the device's axis at its base.
"""

from __future__ import annotations

import atexit
import contextlib
import signal
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from importlib import import_module
from pathlib import Path
from typing import Any, ClassVar, NamedTuple, Self, final

import numpy as np

from tissueid.arrays import FloatArray, IntArray
from tissueid.errors import DeviceError
from tissueid.haptics import guard as machine
from tissueid.haptics.limits import GuardLimits
from tissueid.haptics.states import FAULT_WORDS, Fault, State


@dataclass(frozen=True, slots=True)
class AskedDevice:
    """Options that a user gave on the way to a device."""

    port: str | None = None  # serial port or pseudo-terminal instead of USB
    firmware: str | None = None  # a file
    calibration: Path | None = None  # a file instead of the user's own
    hands_off: bool = False  # the grip moves by itself, in a measurement of the free device
    homing_timeout_s: float | None = None


@dataclass(frozen=True, slots=True)
class DetectedDevice:
    """A device that could be opened, or the reason why not."""

    name: str  # name in the registry
    where: str  # USB node, file or "this program"
    note: str = ""  # what stands in the way and how to remove it; empty if nothing does


@dataclass(frozen=True, slots=True)
class DeviceSample:
    """One reading."""

    time_s: float  # CLOCK_MONOTONIC [s], or the device's virtual time
    position_m: FloatArray  # (3,)
    counts: IntArray  # (3,), encoder counts; :func:`steps_of` its place where a device has none
    buttons: int
    homed: bool
    valid: bool  # whether a whole reply came; without one the other fields repeat the last
    damaged: int = 0  # damaged replies dropped since the last reading


#: Step that stands for one encoder count of a device that has none [m].
STEP_M = 45e-6


def steps_of(position_m: FloatArray) -> IntArray:
    """Steps (3,) of a place (3,) [m] in the stead of counts, by which watchdogs see what moves and stands."""
    return np.floor(np.asarray(position_m) / STEP_M).astype(np.int64)


@dataclass(frozen=True, slots=True)
class Capabilities:
    """Abilities of a device, and if anybody measured them."""

    name: str
    clamp_N: float  # largest force the guard lets through [nominal N]
    calibrated: bool  # whether that newton was weighed on this unit
    damping_N_s_per_m: float  # viscous damping of the arm
    delay_ticks: float  # from a position to the force it causes
    #: Least and largest x, y and z [m].
    workspace_m: tuple[tuple[float, float], tuple[float, float], tuple[float, float]]
    hardware: bool = True  # whether motors move something: then consent and the dead-man button are asked for


@dataclass(frozen=True, slots=True)
class CompiledIO:
    """Handles and constants by which the compiled servo reaches a device without Python."""

    kind: str  # ``module:name`` of the :class:`~tissueid.haptics.device.Access` that takes them
    #: Descriptors, addresses and identities.
    handles: IntArray = field(default_factory=lambda: np.zeros(0, np.int64))
    constants: FloatArray = field(default_factory=lambda: np.zeros(1))
    memory: FloatArray = field(default_factory=lambda: np.zeros(1))  # changed by the loop


#: Commands of zero force on every way out: one lost packet must not leave a torque commanded.
ZERO_COMMANDS = 20
#: Signals that would end or stop a program that holds a device, those of Ctrl-Z and Ctrl-\ among them: its
#: motors would keep their last command.
WAYS_OUT = tuple(
    getattr(signal, f"SIG{name}")
    for name in (
        "TERM", "INT", "HUP", "QUIT", "TSTP", "TTIN", "TTOU", "USR1", "USR2", "ALRM", "VTALRM", "PROF",
        "XCPU", "IO", "PWR", "STKFLT",
    )
    if hasattr(signal, f"SIG{name}")
)  # fmt: skip

#: How long homing may take before it is given up [s].
HOMING_TIMEOUT_S = 60.0
#: Pause between two readings while the user is waited for [s].
TICK_S = 0.001
#: The most of a time-out that one reading takes [s]: a host that stood still has not waited.
MOST_A_READING_S = 0.1

_FINAL = ("open", "close", "sample", "read", "write_force", "engage", "disengage")


class HapticDevice(ABC):
    """Base of every device; ``limits``: what the guard lets through."""

    #: Name in the registry.
    name: ClassVar[str] = ""
    #: Options of the command line that its driver takes: port, firmware, calibration.
    takes: ClassVar[tuple[str, ...]] = ()
    #: Those of them that its driver takes only to say why it refuses them.
    refuses: ClassVar[tuple[str, ...]] = ()

    def __init__(self, limits: GuardLimits) -> None:
        self.limits = limits
        #: Told, in sentences, what the user has to do or to wait for; who can show them replaces it.
        self.tell: Callable[[str], None] = lambda _sentence: None
        #: Called again and again while the device waits for its user; an exception ends the wait.
        self.while_waiting: Callable[[], None] = lambda: None
        #: Memory of the guard: the compiled servo works on the same.
        self.guard_memory = machine.new_guard()
        self._limits = limits.block()
        self._out = np.zeros(3)
        self._velocity = np.zeros(3)
        self._position = np.zeros(3)
        self._counts = np.zeros(3, np.int64)
        self._last_s: float | None = None

    def __init_subclass__(cls, **kwargs: Any) -> None:
        super().__init_subclass__(**kwargs)
        for method in _FINAL:
            if method in cls.__dict__:
                msg = f"{cls.__name__}.{method}: final, a device overrides _open, _close, _read and _write"
                raise TypeError(msg)

    # --- what a backend writes

    @classmethod
    @abstractmethod
    def detect(cls) -> list[DetectedDevice]:
        """Devices of this kind on this machine; never raises for one that is missing or locked."""

    @property
    @abstractmethod
    def capabilities(self) -> Capabilities:
        """Abilities of this device."""

    @abstractmethod
    def _open(self) -> None:
        """Get hold of the device, start its firmware; DeviceError with the way out if that fails."""

    @abstractmethod
    def _close(self) -> None:
        """Let go of the device; zero force was sent before."""

    @abstractmethod
    def _read(self) -> DeviceSample:
        """Read once, without waiting longer than a tick; OSError or DeviceError if the device is gone."""

    @abstractmethod
    def _write(self, force_N: FloatArray) -> None:
        """Send a force [N] that passed the guard; called by :meth:`write_force` and :meth:`close` alone."""

    @classmethod
    def configured(cls, asked: AskedDevice) -> dict[str, Any]:
        """Arguments of the constructor for what was asked, of which it takes all."""
        del asked
        return {}

    @classmethod
    def typical(cls) -> Capabilities:
        """Abilities of one that nobody calibrated."""
        return cls(**cls.configured(AskedDevice())).capabilities

    def facts(self) -> dict[str, Any]:
        """More than its abilities, for print: a calibration."""
        return {}

    def keeps(self, file: Path | None) -> bool:
        """True where a measurement would be kept: in this calibration file, or the user's own."""
        del file
        return False

    def keep(self, file: Path | None, changes: Mapping[str, Any]) -> Path:
        """Put what was measured into the calibration file; its path."""
        del file, changes
        raise DeviceError(f"the device {self.name} keeps no calibration")

    def home(self) -> None:  # noqa: B027 - most devices need no hand for it
        """Lead the user through homing after ``open``; nothing to do where a device needs no hand for it."""

    def compiled(self) -> CompiledIO | None:
        """Handles for the compiled servo, or None: then the loop runs uncompiled and says its rate."""
        return None

    # --- what nobody overrides

    @property
    def state(self) -> State:
        """State of the device."""
        return State(int(self.guard_memory[machine.STATE]))

    @property
    def fault(self) -> Fault:
        """Why it went to FAULT."""
        return Fault(int(self.guard_memory[machine.FAULT]))

    @final
    def open(self) -> None:
        """Open the device, which then wants homing; DeviceError, with the way out, where it can't be."""
        if self.state is not State.CLOSED:
            raise DeviceError(f"{self.name}: is open already")
        machine.transition(self.guard_memory, self._limits, machine.OPENED)
        try:
            self._open()
        except BaseException:
            machine.transition(self.guard_memory, self._limits, machine.SHUT)
            raise
        atexit.register(self.close)
        self._last_s = None
        machine.transition(self.guard_memory, self._limits, machine.FIRMWARE_OK)
        machine.transition(self.guard_memory, self._limits, machine.HOME)

    @final
    def close(self) -> None:
        """Send zero force :data:`ZERO_COMMANDS` times and let go; harmless on a closed device."""
        if self.state is State.CLOSED:
            return
        machine.transition(self.guard_memory, self._limits, machine.SHUT)
        atexit.unregister(self.close)
        for _ in range(ZERO_COMMANDS):
            # a device that is gone has no torque to take back, and closing must come to its end
            with contextlib.suppress(OSError, DeviceError):
                self._write(np.zeros(3))
        with contextlib.suppress(OSError):
            self._close()

    @final
    def sample(self) -> DeviceSample:
        """Read the device without its watchdogs, for a loop with its own; DeviceError, and FAULT, if lost."""
        self._must_be_open()
        try:
            sample = self._read()
        except (OSError, DeviceError) as error:
            raise self._lost(error) from error
        if sample.valid and not np.isfinite(sample.position_m).all():
            # a place that is none would stay in every filter behind it
            return replace(sample, valid=False, damaged=sample.damaged + 1)
        return sample

    @final
    def read(self) -> DeviceSample:
        """Read the device and let the watchdogs see it; DeviceError as :meth:`sample`."""
        sample = self.sample()
        first = self._last_s is None
        dt = 0.0 if self._last_s is None else sample.time_s - self._last_s
        self._last_s = sample.time_s
        reply = machine.REPLY_DAMAGED if sample.damaged else machine.REPLY_NONE
        moved = np.zeros(3, np.int64)
        if sample.valid:
            reply = machine.REPLY_VALID
            # at the end of homing the coordinates jump: nothing moved
            if first or self.state is State.HOMING:
                self._position[:] = sample.position_m
                self._velocity[:] = 0.0
            else:
                moved = sample.counts - self._counts
            machine.velocity_step(self._velocity, sample.position_m, self._position, dt)
            self._counts[:] = sample.counts
        # the depth of the tool is not known here
        machine.observe(
            self.guard_memory, self._limits, reply, sample.homed, sample.buttons, moved, self._velocity,
            float("nan"), dt,
        )  # fmt: skip
        return sample

    @final
    def write_force(self, force_N: Any, dt_s: float) -> FloatArray:
        """Send a wanted force (3,) [N] as far as the guard allows it; what was sent (3,).

        ``dt_s``: measured time since the last call.  Raises DeviceError: the device is closed or gone;
        ValueError: not three components.
        """
        self._must_be_open()
        force = np.asarray(force_N, np.float64)
        if force.shape != (3,):
            raise ValueError(f"force_N must have shape (3,), has {force.shape}")
        machine.guard(self.guard_memory, self._limits, force, float(dt_s), self._out)
        try:
            self._write(self._out)
        except (OSError, DeviceError) as error:
            raise self._lost(error) from error
        return self._out.copy()

    @final
    def engage(self) -> None:
        """Ask for force; it comes once the device is homed, the tool free and the button held."""
        machine.transition(self.guard_memory, self._limits, machine.ENGAGE)

    @final
    def disengage(self) -> None:
        """Take the force away over the dead-man ramp."""
        machine.transition(self.guard_memory, self._limits, machine.DISENGAGE)

    def __enter__(self) -> Self:
        self.open()
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _wait_until(self, reached: Callable[[], bool], timeout_s: float, why_not: Callable[[], str]) -> None:
        """Read and send zero force until something is reached; DeviceError late, on a fault, or lost."""
        waited_s, before = 0.0, time.monotonic()
        zero = np.zeros(3)
        while not reached():
            now = time.monotonic()
            waited_s, before = waited_s + min(now - before, MOST_A_READING_S), now
            if waited_s > timeout_s:
                raise DeviceError(why_not())
            self.while_waiting()
            self.read()
            if self.state is State.FAULT:
                raise DeviceError(f"homing ended: {FAULT_WORDS[self.fault]}")
            self.write_force(zero, TICK_S)
            time.sleep(TICK_S)

    def _lost(self, error: Exception) -> DeviceError:
        """FAULT of a device that is gone, in words."""
        machine.transition(self.guard_memory, self._limits, machine.TRANSPORT_LOST)
        return DeviceError(f"{self.name}: {FAULT_WORDS[Fault.TRANSPORT]} ({error})")

    def _must_be_open(self) -> None:
        if self.state is State.CLOSED:
            raise DeviceError(f"{self.name}: is closed; call open() first")


#: Words of a reading: what came (:mod:`tissueid.haptics.guard`), whether homed, buttons, and commands
#: without an answer where each is answered.
REPLY, HOMED, PRESSED, UNANSWERED = 0, 1, 2, 3
WORDS_SIZE = 4
#: Modules that may register a device.
OURS = "tissueid.haptics."


class Access(NamedTuple):
    """Ways to one kind of device."""

    io: type  # named tuple that stands for a device in a loop
    made: Callable[[CompiledIO], Any]  # :class:`~tissueid.haptics.device.CompiledIO` -> such a tuple
    sense: Callable[..., None]  # compiled: of io, dt, position, counts and words; never waits
    command: Callable[..., None]  # compiled: of io, guard memory, limits and a force that passed the guard


_REGISTERED: dict[type, Access] = {}


def register(access: Access) -> Access:
    """Let loops find a kind of device by the type of its tuple."""
    _REGISTERED[access.io] = access
    return access


def access_of(io: type) -> Access:
    """Ways to the devices that tuples of this type stand for."""
    return _REGISTERED[io]


def compiled_io(given: CompiledIO) -> Any:
    """The tuple for what a device says of itself.

    Raises DeviceError: its kind is none of this package: compiled loops are kept by a hash of its sources
    alone, and would not notice a change of another's.
    """
    module, _, name = given.kind.partition(":")
    # a name of this package that is none is a bug of ours, and an error of its import
    if not module.startswith(OURS):
        msg = f"the compiled servo knows no device of kind {given.kind!r}; return None from compiled()"
        raise DeviceError(msg)
    access: Access = getattr(import_module(module), name)
    return access.made(given)


def declared(library: Any, prototypes: Mapping[str, tuple[Any, list[Any]]], complaint: str) -> Any:
    """The library with results and arguments of its functions; DeviceError with the one that it lacks."""
    for function, (result, arguments) in prototypes.items():
        try:
            symbol = getattr(library, function)
        except AttributeError as error:
            raise DeviceError(f"{complaint}: it has no {function}") from error
        symbol.restype, symbol.argtypes = result, arguments
    return library
