"""The emulated Falcon itself: bytes in, bytes out, by tables; a boot loader before them, and time in between.

Power-up leaves the encoders at an unknown zero; a leg is homed by a pull and a push while homing mode is
commanded, and a command without it forgets that.  The hand's script and the clock of scripted faults begin
with the first homing command.  Time goes by ``advance``, or by a fixed period at each command.  SI units.
"""

from __future__ import annotations

import math
import re
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import Enum

import numpy as np

from tissueid.arrays import FloatArray
from tissueid.compiled import kernel
from tissueid.errors import UsageError, printable, refuse
from tissueid.haptics.arm import POSITION, TIME, Arm, arm_step, new_arm
from tissueid.haptics.hand import Hand
from tissueid.haptics.shared_hand import MAX_KNOTS

LETTERS = b"ABCDEFGHIJKLMNOP"
#: Letters of every 16-bit number, and the number of four letters.
SPELLING = {
    number: bytes(LETTERS[(number >> shift) & 15] for shift in (0, 4, 8, 12))
    for number in range(-32768, 32768)
}
NUMBERS = {letters: number for number, letters in SPELLING.items()}
#: A command: three numbers, flags, one byte of any kind.
COMMAND = re.compile(rb"<([A-P]{12})([A-P]).>", re.DOTALL)
COMMAND_BYTES = 16
#: Bits of the flags: homing mode, and lamps.
HOMING, LAMPS = 1, {2: "green", 4: "blue", 8: "red"}


@dataclass(frozen=True, slots=True)
class Command:
    """Command of a host."""

    motors: tuple[int, int, int]  # motor units of legs 1 to 3, as sent
    homing: bool
    lamps: frozenset[str]


class CommandReader:
    """Finds command packets in a stream of bytes; whatever is none is dropped."""

    def __init__(self) -> None:
        self._kept = b""

    def feed(self, data: bytes) -> list[Command]:
        """Return the commands that ``data`` completes, in order."""
        self._kept += data
        found, end = [], 0
        for packet in COMMAND.finditer(self._kept):
            letters, flags = packet[1], LETTERS.index(packet[2])
            motors = (NUMBERS[letters[:4]], NUMBERS[letters[4:8]], NUMBERS[letters[8:]])
            lamps = frozenset(name for bit, name in LAMPS.items() if flags & bit)
            found.append(Command(motors, bool(flags & HOMING), lamps))
            end = packet.end()
        # the rest may begin a packet
        self._kept = self._kept[end:][1 - COMMAND_BYTES :]
        return found


HELLO = bytes([0x0A, 0x43, 0x0D])
GREETING = bytes([0x0A, 0x44, 0x2C, 0x0D])
READY = b"A"
HELLO_BAUD, BOOT_BAUD, RUN_BAUD = 9600, 142_857, 1_500_000
#: A tty rounds a rate as it likes; a wrong one is off by far more.
BAUD_TOLERANCE = 0.05


class _Stage(Enum):
    GREETING = "waits for a greeting"
    READY = "waits for the start of an upload"
    UPLOAD = "takes firmware"
    BROKEN = "waits for a new start"


@dataclass
class BootLoader:
    """The upload protocol, without a clock: it greets, then echoes every byte it is given.

    The change of the baud rate completes the upload; ``failing_tries``: uploads whose echo is spoilt.
    """

    failing_tries: int = 0
    baud: int | None = None
    taken: int = 0
    tries: int = 0
    _stage: _Stage = _Stage.GREETING
    _tail: bytes = b""

    def set_baud(self, baud: int) -> bool:
        """Take a new rate; True where that starts the firmware."""
        self.baud = baud
        return self._speaks(RUN_BAUD) and self._stage is _Stage.UPLOAD and self.taken > 0

    def feed(self, data: bytes) -> bytes:
        """Answer bytes of the host."""
        return b"".join(self._take(bytes([byte])) for byte in data)

    def _speaks(self, baud: int) -> bool:
        """The rate is the one this stage needs, or the transport has none."""
        return self.baud is None or abs(self.baud - baud) <= BAUD_TOLERANCE * baud

    def _take(self, byte: bytes) -> bytes:
        if self._stage is _Stage.UPLOAD:
            if not self._speaks(BOOT_BAUD):
                return b""
            self.taken += 1
            if self.tries <= self.failing_tries and self.taken == 3 * 62 + 1:
                # the first byte of the fourth chunk comes back spoilt
                self._stage = _Stage.BROKEN
                self._tail = b""
                return bytes([byte[0] ^ 0xFF])
            return byte
        if self._stage is _Stage.READY and byte == READY and self._speaks(BOOT_BAUD):
            self._stage = _Stage.UPLOAD
            self.taken = 0
            self.tries += 1
            return READY
        self._tail = (self._tail + byte)[-len(HELLO) :]
        if self._tail == HELLO and self._speaks(HELLO_BAUD):
            self._tail = b""
            self._stage = _Stage.READY
            return GREETING
        return b""


#: Kinds, and what each does while it lasts.
FAULT_KINDS = {
    "unplug": "the transport closes",
    "silence": "commands are obeyed, none is answered",
    "bad packets": "the letters of every answer are spoilt",
    "short": "an answer lacks its last two bytes before the end",
    "garbled": "one byte of an answer is flipped",
    "doubled": "an answer comes twice",
    "frozen": "the encoders stand still",
    "jump": "encoder 1 is off by `size` counts",
    "creep": "encoder 1 runs away by `size` counts a second",
    "unhomed": "leg 2 is no longer homed",
    "stall": "the answer comes `size` milliseconds late",
}
#: An answer as a fault of the wire leaves it.
SPOILT: dict[str, Callable[[bytes], bytes]] = {
    "unplug": lambda _packet: b"",
    "silence": lambda _packet: b"",
    "bad packets": lambda packet: packet[:1] + bytes(letter | 0x80 for letter in packet[1:15]) + packet[15:],
    "short": lambda packet: packet[:13] + packet[15:],
    "garbled": lambda packet: packet[:6] + bytes([packet[6] ^ 0x20]) + packet[7:],
    "doubled": lambda packet: packet + packet,
}
#: Kinds that spoil one answer where no duration is given.
SINGLE = frozenset({"short", "garbled", "doubled", "stall"})


@dataclass(frozen=True, slots=True)
class ScriptedFault:
    """One fault."""

    kind: str  # one of :data:`FAULT_KINDS`
    at_s: float  # when it begins [s after homing was first commanded]
    #: How long it lasts; None is for good, and one answer for "short", "garbled", "doubled" and "stall".
    duration_s: float | None = None
    size: float = 1000.0  # counts of a jump, counts a second of a creep, milliseconds of a stall

    def __post_init__(self) -> None:
        if self.kind not in FAULT_KINDS:
            refuse(f"there is no fault {printable(self.kind)!r}; faults are {', '.join(FAULT_KINDS)}")

    def active(self, time_s: float) -> bool:
        """It is on at a time of the device's clock [s]."""
        return self.at_s <= time_s and (self.duration_s is None or time_s < self.at_s + self.duration_s)


def parse_fault(text: str) -> ScriptedFault:
    """Read ``KIND@SECONDS[:SIZE][/DURATION]``, e.g. ``jump@6:300`` or ``silence@5/0.5``; else UsageError."""
    kind, _, rest = text.partition("@")
    rest, _, duration = rest.partition("/")
    at, _, size = rest.partition(":")
    try:
        numbers = float(at), float(duration) if duration else None, float(size) if size else 1000.0
    except ValueError:
        refuse(
            f"{printable(text)!r} is no fault; write KIND@SECONDS, e.g. unplug@6, jump@6:300 or silence@5/0.5"
        )
    return ScriptedFault(kind.strip(), numbers[0], numbers[1], numbers[2])


#: Thigh, shin and the two pins together [m].
THIGH_M, SHIN_M, PINS_M = 0.060, 0.1025, 0.01125 + 0.01125
#: Wrist from the platform's centre, and pivot, each along and across the leg [m].
WRIST_M, PIVOT_M = (0.01443, -0.025), (0.040, -0.02309)
AZIMUTHS = np.radians(np.array([105.0, -15.0, -135.0]))
ZERO_RAD = math.radians(35.0)
#: 320 lines, four edges each, behind a drum of 110 on a capstan of 14.25.
COUNTS_PER_RAD = 320.0 * 4.0 / (2.0 * math.pi) * 110.0 / 14.25
#: Halvings of a bracket of pi: to 2e-14 rad.
HALVINGS = 47
#: Step of the differences [m]: truncation and rounding are both below 1e-7 of the result.
DIFFERENCE_M = 1e-5


@kernel()
def _shin_excess(angle: float, along: float, out: float, lean: float) -> float:
    """Length the shin would need at a thigh angle, less the one it has."""
    rho = math.hypot(along - THIGH_M * math.cos(angle), out - THIGH_M * math.sin(angle))
    # nearer than the pins are long, the parallelogram would have to fold over itself
    return float(math.copysign(math.hypot(rho - PINS_M, lean), rho - PINS_M) - SHIN_M)


@kernel()
def leg_angles(position: FloatArray, angles: FloatArray) -> bool:
    """Write the thighs' angles (3,) [rad] at a position [m]; False, and one left, where a leg can't reach.

    A leg stands where ``hypot(rho - d - e, q) = b`` (Stamper, 1997), with rho the distance from knee to
    wrist, which falls monotonically while the thigh turns toward the wrist: bisection finds it on the built
    side.
    """
    reached = True
    for leg in range(3):
        c, s = math.cos(AZIMUTHS[leg]), math.sin(AZIMUTHS[leg])
        along = c * position[0] + s * position[1] - PIVOT_M[0] + WRIST_M[0]
        lean = c * position[1] - s * position[0] - PIVOT_M[1] + WRIST_M[1]
        high = math.atan2(position[2], along)
        low = high - math.pi
        far = _shin_excess(low, along, position[2], lean)
        near = _shin_excess(high, along, position[2], lean)
        if not (abs(lean) <= SHIN_M and far >= 0.0 >= near):
            reached = False
            continue
        for _ in range(HALVINGS):
            middle = 0.5 * (low + high)
            if _shin_excess(middle, along, position[2], lean) > 0.0:
                low = middle
            else:
                high = middle
        angles[leg] = 0.5 * (low + high)
    return reached


@kernel()
def grip_force(position: FloatArray, torque: FloatArray, force: FloatArray) -> bool:
    """Write the force [N] of arm torques [N m], by differences: zero, and False, out of reach."""
    place = position.copy()
    ahead = np.zeros(3)
    behind = np.zeros(3)
    force[:] = 0.0
    for axis in range(3):
        place[axis] = position[axis] + DIFFERENCE_M
        reached = leg_angles(place, ahead)
        place[axis] = position[axis] - DIFFERENCE_M
        reached = leg_angles(place, behind) and reached
        place[axis] = position[axis]
        if not reached:
            force[:] = 0.0
            return False
        for leg in range(3):
            force[axis] += torque[leg] * (ahead[leg] - behind[leg]) / (2.0 * DIFFERENCE_M)
    return True


#: Counts beyond which a leg counts as pulled out or pushed in; the stops are near +-1600.
OUT_COUNTS, IN_COUNTS = 1000.0, -1000.0
#: Where the grip hangs when the device is switched on [m].
START_M = (0.0, 0.0, 0.12)
PULLED_M, PUSHED_M = (0.0, 0.0, 0.178), (0.0, 0.0, 0.080)
#: Time the emulated user takes to pull out, push in, and pull out again [s].
HOME_S = 2.4
#: Longest stretch of time over which the motors' force is held while the arm moves [s].
HELD_FORCE_S = 1e-3
#: Motor units for one N m of arm torque, and time from a command's arrival to its torque [s].
UNITS_PER_NM = 6600.0
MOTOR_DELAY_S = 5e-4
#: Button that the emulated user holds: the dead man's.
HELD_BUTTON = 0x04


@dataclass(frozen=True, slots=True)
class EmulatorSettings:
    """Settings of an emulated Falcon."""

    hand: Hand | None = None  # what holds the grip after homing; None rests it at the pulled-out end
    firmware_loaded: bool = True  # switched on with its firmware running
    failing_tries: int = 0  # uploads that fail before one succeeds
    homes: bool = True  # false: the user never homes the device
    #: After homing the user waits for the blue lamp, which a driver shows with force; time stands still until
    #: then.
    waits_for_blue: bool = False
    #: Time that goes by at each command (virtual time); None: only by ``advance``.
    period_s: float | None = None
    faults: tuple[ScriptedFault, ...] = ()


def with_homing(hand: Hand | None, *, homes: bool = True) -> Hand:
    """Put the pull and the push of homing before a hand's own motion; UsageError for too many knots."""
    own = hand or Hand((0.0,), (PULLED_M,), (1.0,), stiffness_N_per_m=1000.0)
    if not homes:
        return replace(own, times_s=(0.0,), positions_m=(START_M,), grips=(1.0,), rigid=True)
    times = (0.0, 0.6, 0.8, 1.6, 2.0, HOME_S)
    places = (START_M, PULLED_M, PULLED_M, PUSHED_M, PULLED_M, PULLED_M)
    begin = HOME_S + 0.6
    if len(times) + len(own.times_s) > MAX_KNOTS:
        msg = f"a hand of {len(own.times_s)} knots is too long for the emulator, {MAX_KNOTS - len(times)} fit"
        raise UsageError(msg)
    return replace(
        own,
        times_s=(*times, *(begin + time for time in own.times_s)),
        positions_m=(*places, *own.positions_m),
        grips=(*(1.0 for _ in times), *own.grips),
    )


class EmulatedFalcon:
    """One device; see the module for its rules."""

    def __init__(self, settings: EmulatorSettings) -> None:
        self.settings = settings
        self.running = settings.firmware_loaded
        self.lamps: frozenset[str] = frozenset()
        self.commands = 0
        self.last_motors = (0, 0, 0)
        self.gone = False
        self.boot = BootLoader(settings.failing_tries)
        self._reader = CommandReader()
        self.parameters = with_homing(settings.hand, homes=settings.homes).write(Arm().block())
        self.memory = new_arm(np.array(START_M))
        self._angles = np.zeros(3)
        leg_angles(np.array(START_M), self._angles)
        # an unknown zero: the counters start at nought wherever the grip hangs
        self._zero = np.floor((self._angles - ZERO_RAD) * COUNTS_PER_RAD)
        self._pulled = np.zeros(3, dtype=bool)
        self._homed = np.zeros(3, dtype=bool)
        self._waiting = True
        self._held_up = settings.waits_for_blue
        self._homing_mode = False
        self._under_way: deque[tuple[float, tuple[int, int, int]]] = deque()
        self._motors = (0, 0, 0)
        self._stuck: tuple[int, int, int] | None = None
        self._spent: set[int] = set()
        self.answer_delay_s = 0.0
        self.force_N = np.zeros(3)
        # compiled, or taken from the disk, now: at the first force it would be silent for half a second
        grip_force(np.array(START_M), np.zeros(3), np.zeros(3))
        arm_step(self.memory.copy(), self.parameters, self.force_N, HELD_FORCE_S)

    # --- what a test may look at
    @property
    def time_s(self) -> float:
        """Time [s] since homing was first commanded."""
        return float(self.memory[TIME])

    @property
    def position_m(self) -> FloatArray:
        """True position of the grip [m], shape (3,)."""
        return self.memory[POSITION : POSITION + 3].copy()

    # --- the wire
    def set_baud(self, baud: int) -> None:
        """The host chose a baud rate; that of the running firmware ends an upload."""
        self.running = self.boot.set_baud(baud) or self.running

    def receive(self, data: bytes) -> bytes:
        """Take bytes of the host; the answer, ``gone`` if unplugged, ``answer_delay_s`` if stalled."""
        if not self.running:
            return self.boot.feed(data)
        return b"".join(self._obey(command) for command in self._reader.feed(data))

    def _obey(self, command: Command) -> bytes:
        self.commands += 1
        if command.homing:
            self._waiting = False
        if self.settings.period_s is not None:
            self.advance(self.settings.period_s)
        self._homing_mode = command.homing
        if not command.homing:
            self._pulled[:] = False
            self._homed[:] = False
        self.lamps = command.lamps
        self.last_motors = command.motors
        self._under_way.append((self.time_s + MOTOR_DELAY_S, command.motors))
        return self._answer()

    def _answer(self) -> bytes:
        counts = self.counts()
        # a bit for each leg
        homed = int(self._homed @ (1, 2, 4)) if self._homing_mode else 0
        fault = self._fault()
        kind, size, at_s = ("", 0.0, 0.0) if fault is None else (fault.kind, fault.size, fault.at_s)
        self._stuck = (self._stuck or counts) if kind == "frozen" else None
        first, second, third = self._stuck or counts
        if kind == "jump":
            first += int(size)
        elif kind == "creep":
            first += int(size * (self.time_s - at_s))
        elif kind == "unhomed":
            homed &= 0b101
        self.gone = self.gone or kind == "unplug"
        self.answer_delay_s = size * 1e-3 if kind == "stall" else 0.0
        # counts wrap at 16 bits
        spelled = b"".join(SPELLING[(count + 32768) % 65536 - 32768] for count in (first, second, third))
        packet = b"<" + spelled + bytes([0x41 + HELD_BUTTON + (homed << 4)]) + b"A>"
        return SPOILT[kind](packet) if kind in SPOILT else packet

    def _fault(self) -> ScriptedFault | None:
        """The first scripted fault that is on; one that spoils a single answer is then used up."""
        for index, fault in enumerate(self.settings.faults):
            if not self._waiting and index not in self._spent and fault.active(self.time_s):
                if fault.duration_s is None and fault.kind in SINGLE:
                    self._spent.add(index)
                return fault
        return None

    def counts(self) -> tuple[int, int, int]:
        """Encoder counts as the device knows them: from an unknown zero on a leg that is not homed."""
        whole = np.floor((self._angles - ZERO_RAD) * COUNTS_PER_RAD)
        said = np.where(self._homed, whole, whole - self._zero)
        return int(said[0]), int(said[1]), int(said[2])

    # --- time
    def advance(self, dt: float) -> None:
        """Let ``dt`` seconds pass, once homing was commanded."""
        if self._held_up and "blue" in self.lamps:
            self._held_up = False
        if self._waiting:
            return
        end = self.time_s + dt
        if self._held_up:
            # a starved emulator takes long steps; none may lead past the place where the user waits
            end = min(end, HOME_S)
        while self._under_way and self._under_way[0][0] <= end:
            arrival, motors = self._under_way.popleft()
            self._move(arrival)
            self._motors = motors
        self._move(end)

    def _move(self, until: float) -> None:
        """Move the arm under the present torques, which push differently as the grip moves."""
        torque = np.array(self._motors, dtype=np.float64) / -UNITS_PER_NM
        pushed = any(self._motors)
        place = self.memory[POSITION : POSITION + 3]
        while (left := until - self.time_s) > 1e-12:
            if pushed:
                grip_force(place, torque, self.force_N)
            else:
                self.force_N[:] = 0.0
            arm_step(self.memory, self.parameters, self.force_N, min(left, HELD_FORCE_S))
            leg_angles(place, self._angles)
            if self._homing_mode:
                # a leg that was pulled out and is now pushed in knows its zero
                true = (self._angles - ZERO_RAD) * COUNTS_PER_RAD
                self._pulled |= true > OUT_COUNTS
                self._homed |= self._pulled & (true < IN_COUNTS)
