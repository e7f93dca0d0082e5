"""Faults put into the code between a hand and a motor, one at a time, and the tests that must see each.

A mutant is a piece of a source that stands there once, what stands there instead, and where it is looked for.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Mutant:
    """One fault.

    Attributes
    ----------
    name : str
    file : str
        In the package.
    old, new : str
        What stands there once, and what is put in its place.
    tests : tuple of str
        Files of tests, or tests, that must fail.
    """

    name: str
    file: str
    old: str
    new: str
    tests: tuple[str, ...]


_GUARD = "haptics/guard.py"
_TICK = "rendering/servo_tick.py"
_LOOP = "rendering/servo_loop.py"
_PASSIVITY = "rendering/passivity_control.py"
_ENVIRONMENT = "rendering/environment.py"
_DEVICE = "haptics/device.py"
_PACKETS = "haptics/falcon/packets.py"
_KINEMATICS = "haptics/falcon/kinematics.py"
_FALCON = "haptics/falcon/servo_io.py"
_CONTROL = "rendering/control/law.py"

_OF_GUARD = ("tests/haptics/test_haptics_guard.py", "tests/haptics/test_haptics_guard_invariants.py")
_OF_DEVICE = ("tests/haptics/test_haptics_device.py",)
_OF_TICK = ("tests/render/test_render_tick_memory.py", "tests/render/test_render_servo_tick.py")
_OF_PASSIVITY = ("tests/render/test_render_passivity_control.py",)
_OF_ENVIRONMENT = ("tests/render/test_render_environment.py",)
_OF_PACKETS = ("tests/haptics/test_haptics_falcon_packets.py",)
_OF_KINEMATICS = ("tests/haptics/test_haptics_falcon_kinematics.py",)
_OF_FAULTS = ("tests/render/test_render_faults.py",)
_OF_CONTROL = ("tests/render/test_render_control_law.py",)

#: Caught by tests that run without compilation.
INTERPRETED = (
    Mutant("clamp left out", _GUARD, "if bound > limits[bar.CLAMP_N]:", "if False:", _OF_GUARD),
    Mutant("clamp of each axis", _GUARD, "out[i] = out[i] * scale", "out[i] = min(out[i], bound)", _OF_GUARD),
    Mutant("slew left out", _GUARD, "if bound > risen:", "if False:", _OF_GUARD),
    Mutant(
        "slew of the length alone",
        _GUARD,
        "risen = max(along, 0.0) +",
        "risen = _length(memory[PREVIOUS:PREVIOUS+3]) +",
        _OF_GUARD,
    ),
    Mutant("slew from below zero", _GUARD, "risen = max(along, 0.0) +", "risen = along +", _OF_GUARD),
    Mutant("sustained limit left out", _GUARD, "if bound > sustained:", "if False:", _OF_GUARD),
    Mutant("overheating unseen", _GUARD, "fail(memory, _OVERHEATED)", "pass", _OF_GUARD),
    Mutant(
        "no number passes",
        _GUARD,
        "            fail(memory, _NOT_A_NUMBER)",
        "            _advance_gain(memory, limits, step, stalled)",
        _OF_GUARD,
    ),
    Mutant("one axis unlooked at", _GUARD, " and math.isfinite(force[2])", "", _OF_GUARD),
    Mutant(
        "force in every state",
        _GUARD,
        "    if memory[STATE] == ENGAGED:\n        lamps |=",
        "    if memory[STATE] >= ARMED:\n        lamps |=",
        _OF_GUARD,
    ),
    Mutant(
        "a fault keeps its force",
        _GUARD,
        "out[i] = left * memory[FAULT_FORCE + i]",
        "out[i] = memory[FAULT_FORCE + i]",
        _OF_GUARD,
    ),
    Mutant(
        "a fault's age stands still in a stall",
        _GUARD,
        "            age = min(dt, LONGEST_STALL_S)",
        "            age = 0.0",
        _OF_GUARD,
    ),
    Mutant("damping pushes", _GUARD, "gain * force[i] - damping *", "gain * force[i] + damping *", _OF_GUARD),
    Mutant(
        "no ramp at engaging",
        _GUARD,
        "    memory[GAIN] = 0.0\n    memory[RISE_RATE]",
        "    memory[GAIN] = 1.0\n    memory[RISE_RATE]",
        _OF_GUARD,
    ),
    Mutant(
        "engaged inside tissue", _GUARD, "memory[READY] != 0.0 and free:", "memory[READY] != 0.0:", _OF_GUARD
    ),
    Mutant(
        "an unknown depth is a free tool",
        _GUARD,
        "memory[PENETRATION] <= 0.0 or",
        "not memory[PENETRATION] > 0.0 or",
        _OF_GUARD,
    ),
    Mutant("a stall unseen", _GUARD, "    if stalled:\n        pause(memory, limits)\n", "", _OF_GUARD),
    Mutant(
        "a late wire lowers nothing",
        _GUARD,
        "(limits[bar.DELAY_TICKS] + memory[DELAYED_TICKS])",
        "limits[bar.DELAY_TICKS]",
        _OF_TICK,
    ),
    Mutant(
        "the second fault is reported",
        _GUARD,
        "if memory[STATE] == FAULTED or memory[STATE] == CLOSED:",
        "if memory[STATE] == CLOSED:",
        _OF_GUARD,
    ),
    Mutant("shut with force", _GUARD, "        memory[STATE] = CLOSED\n", "        pass\n", _OF_GUARD),
    Mutant(
        "parameters change in contact",
        _GUARD,
        "state != ENGAGED or memory[PENETRATION] <= 0.0",
        "True",
        _OF_GUARD,
    ),
    Mutant("silence unseen", _GUARD, "        fail(memory, _NO_REPLY)", "        pass", _OF_GUARD),
    Mutant(
        "silence keeps its force",
        _GUARD,
        "        pause(memory, limits)\n        # nobody",
        "        # nobody",
        _OF_GUARD,
    ),
    Mutant(
        "silence damps by an old velocity",
        _GUARD,
        "        for i in range(3):\n            memory[VELOCITY + i] = 0.0\n",
        "        pass\n",
        _OF_GUARD,
    ),
    Mutant("damaged packets are good", _GUARD, "        memory[DAMAGED] += 1.0", "        pass", _OF_GUARD),
    Mutant("a jump unseen", _GUARD, "            fail(memory, _JUMP)", "            pass", _OF_GUARD),
    Mutant(
        "a jump of one leg alone",
        _GUARD,
        "    for i in range(3):\n        if abs(counts_moved[i])",
        "    for i in range(1):\n        if abs(counts_moved[i])",
        _OF_GUARD,
    ),
    Mutant("a gap is a jump", _GUARD, "    if gap > limits[bar.JUMP_S]:", "    if False:", _OF_GUARD),
    Mutant("too fast unseen", _GUARD, "        fail(memory, _OVERSPEED)", "        pass", _OF_GUARD),
    Mutant(
        "lost homing unseen",
        _GUARD,
        "        fail(memory, _NOT_HOMED)\n        return",
        "        return",
        _OF_GUARD,
    ),
    Mutant("a frozen encoder unseen", _GUARD, "        yield_to(memory, _FROZEN)", "        pass", _OF_GUARD),
    Mutant(
        "a resting hand is frozen",
        _GUARD,
        "memory[STILL_CHANGE_N] > least and force2",
        "force2",
        _OF_GUARD,
    ),
    Mutant(
        "the button is always held",
        _GUARD,
        "held = limits[bar.DEAD_MAN] == 0.0 or",
        "held = True or",
        _OF_GUARD,
    ),
    Mutant("any button will do", _GUARD, "buttons & int(limits[bar.DEAD_MAN_BUTTONS])", "buttons", _OF_GUARD),
    Mutant(
        "armed by one reply",
        _GUARD,
        "memory[HOMED_REPLIES] + 1.0 if homed",
        "limits[bar.HOMED_NEEDED] if homed",
        _OF_GUARD,
    ),
    Mutant(
        "a late answer is forgotten at once",
        _GUARD,
        "memory[DELAYED_TICKS] - FORGOTTEN_PER_S * dt",
        "memory[DELAYED_TICKS] - 1e6 * dt",
        _OF_TICK,
    ),
    Mutant(
        "closed without zeros", _DEVICE, "for _ in range(ZERO_COMMANDS):", "for _ in range(0):", _OF_DEVICE
    ),
    Mutant(
        "no zeros at the end of the program", _DEVICE, "        atexit.register(self.close)\n", "", _OF_DEVICE
    ),
    Mutant("a force past the guard", _DEVICE, "self._write(self._out)", "self._write(force)", _OF_DEVICE),
    Mutant(
        "a lost transport is no fault",
        _DEVICE,
        "        machine.transition(self.guard_memory, self._limits, machine.TRANSPORT_LOST)",
        "        pass",
        _OF_DEVICE,
    ),
    Mutant("tissue remembers another", _TICK, "    put_at_rest(environment_memory)\n", "", _OF_TICK),
    Mutant("a gap is one tick", _TICK, "        servo.since_valid[0] = 0.0\n", "", _OF_TICK),
    Mutant(
        "energy of what was wanted", _TICK, "    note_sent(servo.control_memory, servo.out)\n", "", _OF_TICK
    ),
    Mutant(
        "the owner's wish unheard",
        _TICK,
        "        transition(guard_memory, limits, DISENGAGE)",
        "        pass",
        _OF_TICK,
    ),
    Mutant(
        "the step is a millisecond",
        _TICK,
        "step = min(max(dt, SHORTEST_STEP_S), LONGEST_STEP_S)",
        "step = 1e-3",
        _OF_TICK,
    ),
    Mutant(
        "an old reading moved the hand",
        _TICK,
        "    fresh = servo.counters[SEEN] < FRESH_READINGS or memory[STATE] <= HOMING\n",
        "    fresh = False\n",
        _OF_TICK,
    ),
    Mutant(
        "unanswered commands unseen",
        _TICK,
        "    observe_wire(memory, limits, words[UNANSWERED], dt)\n",
        "",
        _OF_TICK,
    ),
    Mutant(
        "the ledger in the wrong direction",
        _PASSIVITY,
        "taken -= memory[SENT + i] * moved",
        "taken += memory[SENT + i] * moved",
        _OF_PASSIVITY,
    ),
    Mutant("the brake pushes", _PASSIVITY, "    scale = -damping\n", "    scale = damping\n", _OF_PASSIVITY),
    Mutant(
        "the brake without a bound",
        _PASSIVITY,
        "    if damping * speed > parameters[LARGEST_CORRECTION_N]:",
        "    if False:",
        _OF_PASSIVITY,
    ),
    Mutant(
        "the brake jumps",
        _PASSIVITY,
        "    if change > parameters[LARGEST_CHANGE_N]:",
        "    if False:",
        _OF_PASSIVITY,
    ),
    Mutant(
        "the force of tissue pulls",
        _ENVIRONMENT,
        "force[i] = device_force * memory[NORMAL + i]",
        "force[i] = -device_force * memory[NORMAL + i]",
        _OF_ENVIRONMENT,
    ),
    Mutant(
        "the motion is not scaled",
        _ENVIRONMENT,
        "depth = penetration / parameters[MOTION_SCALE] * M_TO_MM",
        "depth = penetration * M_TO_MM",
        _OF_ENVIRONMENT,
    ),
    Mutant(
        "broken tissue is whole",
        _ENVIRONMENT,
        "        memory[BROKEN] = 1.0\n",
        "        pass\n",
        _OF_ENVIRONMENT,
    ),
    Mutant(
        "a letter of another packet fits",
        _PACKETS,
        "    if not _fits(filled, byte):",
        "    if False:",
        _OF_PACKETS,
    ),
    Mutant(
        "torque in the wrong direction",
        _KINEMATICS,
        "    scale = -units_per_Nm\n",
        "    scale = units_per_Nm\n",
        _OF_KINEMATICS,
    ),
    Mutant(
        "motors without a clamp",
        _KINEMATICS,
        "    clipped = together > clamp_units\n",
        "    clipped = False\n",
        _OF_KINEMATICS,
    ),
    Mutant(
        "a clamp that is rounded up",
        _KINEMATICS,
        "out[i], left[i] = int(scale * torque[i]), 0.0",
        "out[i], left[i] = round(scale * torque[i] + 0.4), 0.0",
        _OF_KINEMATICS,
    ),
    Mutant(
        "rounding that adds up beyond the clamp",
        _KINEMATICS,
        "    if clipped or square > clamp_units * clamp_units:\n",
        "    if clipped:\n",
        _OF_KINEMATICS,
    ),
    Mutant(
        "what rounding left is forgotten",
        _KINEMATICS,
        "        left[i] = wanted - out[i]\n",
        "        left[i] = 0.0\n",
        _OF_KINEMATICS,
    ),
    Mutant(
        "what rounding left is sent without a force",
        _KINEMATICS,
        "        left[0] = left[1] = left[2] = 0.0\n",
        "        pass\n",
        _OF_KINEMATICS,
    ),
    Mutant(
        "a mirrored hand is believed",
        _KINEMATICS,
        "steps >= 0 and _knees_outward(found, angles, geometry):",
        "steps >= 0:",
        _OF_KINEMATICS,
    ),
    Mutant(
        "the controller without a bound",
        _CONTROL,
        "    if length > block.saturation_N:",
        "    if False:",
        _OF_CONTROL,
    ),
    Mutant(
        "the controller takes the hand twice",
        _CONTROL,
        "            total -= hand[i]",
        "            total += hand[i]",
        _OF_CONTROL,
    ),
    Mutant(
        "the reference runs away",
        _CONTROL,
        "vr[i] = ve[i] + rate * (xe[i] - x[i])",
        "vr[i] = ve[i] - rate * (xe[i] - x[i])",
        _OF_CONTROL,
    ),
)

#: Caught by tests of the compiled loop alone.
COMPILED = (
    Mutant(
        "a lost device is silent",
        _FALCON,
        "        if length <= 0:\n            parts.flags[LOST] = 1\n",
        "        if length <= 0:\n            length = 0\n",
        _OF_FAULTS,
    ),
    Mutant(
        "homing mode is left",
        _FALCON,
        "leds_of_state(int(guard_memory[STATE])), True,",
        "leds_of_state(int(guard_memory[STATE])), False,",
        _OF_FAULTS,
    ),
    Mutant(
        "commands are never counted",
        _FALCON,
        "    parts.flags[UNANSWERED] += 1\n    ready",
        "    ready",
        ("tests/render/test_render_faults.py::test_a_late_wire_lights_its_lamp_and_lowers_the_force",),
    ),
    Mutant(
        "a pose that is none is believed",
        _FALCON,
        "elif not found or _alone(parts.since, parts.last, counts):",
        "elif _alone(parts.since, parts.last, counts):",
        ("tests/haptics/test_haptics_servo_drivers.py",),
    ),
    Mutant(
        "a leg that goes on alone is believed",
        _FALCON,
        "elif not found or _alone(parts.since, parts.last, counts):",
        "elif not found:",
        ("tests/render/test_render_faults.py",),
    ),
    Mutant(
        "legs that move together count as one alone",
        _FALCON,
        "others > STILL_COUNTS",
        "others > 10 * ALONE_COUNTS",
        ("tests/render/test_render_faults.py",),
    ),
    Mutant(
        "a dead owner unseen",
        _LOOP,
        "        transition(servo.guard_memory, servo.limits, PARENT_DIED)\n",
        "        pass\n",
        ("tests/render/test_render_homing.py", "tests/render/test_render_servo_process.py"),
    ),
)
