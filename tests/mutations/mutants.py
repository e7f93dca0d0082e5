"""Faults put into the code between a hand and a motor, one at a time, and the tests that must see each."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Mutant:
    """One fault: what stands once in a file of the package, what is put there, and tests that must fail."""

    name: str
    file: str
    old: str
    new: str
    tests: tuple[str, ...]


def faults(file: str, tests: tuple[str, ...], table: dict[str, tuple[str, str]]) -> tuple[Mutant, ...]:
    """Faults of one file for the same tests, by their names: what stands there, and what instead."""
    return tuple(Mutant(name, file, old, new, tests) for name, (old, new) in table.items())


#: Beginning of the tests of whole sessions, a few of which are run without compilation: that takes longer.
SESSIONS = "tests/render/test_render_faults.py::test_a"

#: Caught by tests that run without compilation.
INTERPRETED = (
    *faults(
        "haptics/guard.py",
        ("tests/haptics/test_haptics_guard.py", "tests/haptics/test_haptics_guard_invariants.py"),
        {
            "clamp left out": ("if bound > limits[bar.CLAMP_N]:", "if False:"),
            "clamp of each axis": ("out[i] = out[i] * scale", "out[i] = min(out[i], bound)"),
            "slew left out": ("if bound > risen:", "if False:"),
            "slew of the length alone": (
                "risen = max(along, 0.0) +", "risen = _length(memory[PREVIOUS:PREVIOUS+3]) +",
            ),
            "slew from below zero": ("risen = max(along, 0.0) +", "risen = along +"),
            "sustained limit left out": ("if bound > sustained:", "if False:"),
            "overheating unseen": ("fail(memory, _OVERHEATED)", "pass"),
            "no number passes": (
                "            fail(memory, _NOT_A_NUMBER)",
                "            _advance_gain(memory, limits, step, stalled)",
            ),
            "one axis unlooked at": (" and math.isfinite(force[2])", ""),
            "force in every state": (
                "    if memory[STATE] == ENGAGED:\n        lamps |=",
                "    if memory[STATE] >= ARMED:\n        lamps |=",
            ),
            "a fault keeps its force": (
                "out[i] = left * memory[FAULT_FORCE + i]", "out[i] = memory[FAULT_FORCE + i]",
            ),
            "a fault's age stands still in a stall": (
                "            age = min(dt, LONGEST_STALL_S)", "            age = 0.0",
            ),
            "damping pushes": ("gain * force[i] - damping *", "gain * force[i] + damping *"),
            "no ramp at engaging": (
                "    memory[GAIN] = 0.0\n    memory[RISE_RATE]",
                "    memory[GAIN] = 1.0\n    memory[RISE_RATE]",
            ),
            "engaged inside tissue": ("memory[READY] != 0.0 and free:", "memory[READY] != 0.0:"),
            "an unknown depth is a free tool": (
                "memory[PENETRATION] <= 0.0 or", "not memory[PENETRATION] > 0.0 or",
            ),
            "a stall unseen": ("    if stalled:\n        pause(memory, limits)\n", ""),
            "the second fault is reported": (
                "if memory[STATE] == FAULTED or memory[STATE] == CLOSED:", "if memory[STATE] == CLOSED:",
            ),
            "shut with force": ("        memory[STATE] = CLOSED\n", "        pass\n"),
            "parameters change in contact": ("state != ENGAGED or memory[PENETRATION] <= 0.0", "True"),
            "silence unseen": ("        fail(memory, _NO_REPLY)", "        pass"),
            "silence keeps its force": (
                "        pause(memory, limits)\n        # nobody", "        # nobody",
            ),
            "silence damps by an old velocity": (
                "        for i in range(3):\n            memory[VELOCITY + i] = 0.0\n", "        pass\n",
            ),
            "damaged packets are good": ("        memory[DAMAGED] += 1.0", "        pass"),
            "a jump unseen": ("            fail(memory, _JUMP)", "            pass"),
            "a jump of one leg alone": (
                "    for i in range(3):\n        if abs(counts_moved[i])",
                "    for i in range(1):\n        if abs(counts_moved[i])",
            ),
            "a gap is a jump": ("    if gap > limits[bar.JUMP_S]:", "    if False:"),
            "too fast unseen": ("        fail(memory, _OVERSPEED)", "        pass"),
            "lost homing unseen": ("        fail(memory, _NOT_HOMED)\n        return", "        return"),
            "a frozen encoder unseen": ("        yield_to(memory, _FROZEN)", "        pass"),
            "a resting hand is frozen": ("memory[STILL_CHANGE_N] > least and force2", "force2"),
            "the button is always held": ("held = limits[bar.DEAD_MAN] == 0.0 or", "held = True or"),
            "any button will do": ("buttons & int(limits[bar.DEAD_MAN_BUTTONS])", "buttons"),
            "armed by one reply": (
                "memory[HOMED_REPLIES] + 1.0 if homed", "limits[bar.HOMED_NEEDED] if homed",
            ),
        },
    ),
    *faults(
        "haptics/guard.py",
        ("tests/render/test_render_servo_tick.py",),
        {
            "a late wire lowers nothing": (
                "(limits[bar.DELAY_TICKS] + memory[DELAYED_TICKS])", "limits[bar.DELAY_TICKS]",
            ),
            "a late answer is forgotten at once": (
                "memory[DELAYED_TICKS] - FORGOTTEN_PER_S * step", "memory[DELAYED_TICKS] - 1e6 * dt",
            ),
        },
    ),
    *faults(
        "haptics/device.py",
        ("tests/haptics/test_haptics_device.py",),
        {
            "closed without zeros": ("for _ in range(ZERO_COMMANDS):", "for _ in range(0):"),
            "no zeros at the end of the program": ("        atexit.register(self.close)\n", ""),
            "a force past the guard": ("self._write(self._out)", "self._write(force)"),
            "a lost transport is no fault": (
                "        machine.transition(self.guard_memory, self._limits, machine.TRANSPORT_LOST)",
                "        pass",
            ),
        },
    ),
    *faults(
        "rendering/servo_tick.py",
        ("tests/render/test_render_servo_tick.py",),
        {
            "tissue remembers another": ("    put_at_rest(environment_memory)\n", ""),
            "a gap is one tick": ("        servo.since_valid[0] = 0.0\n", ""),
            "energy of what was wanted": ("    passivity.note_sent(servo.control_memory, servo.out)\n", ""),
            "the owner's wish unheard": (
                "        machine.transition(guard_memory, limits, machine.DISENGAGE)", "        pass",
            ),
            "the step is a millisecond": (
                "step = min(max(dt, SHORTEST_STEP_S), LONGEST_STEP_S)", "step = 1e-3",
            ),
            "an old reading moved the hand": (
                "    fresh = servo.counters[SEEN] < FRESH_READINGS or memory[machine.STATE]",
                "    fresh = False and memory[machine.STATE]",
            ),
            "unanswered commands unseen": (
                "    machine.observe_wire(memory, limits, words[devices.UNANSWERED], dt)\n", "",
            ),
        },
    ),
    *faults(
        "rendering/passivity_control.py",
        ("tests/render/test_render_passivity_control.py",),
        {
            "the ledger in the wrong direction": (
                "taken -= memory[SENT + i] * moved", "taken += memory[SENT + i] * moved",
            ),
            "the brake pushes": ("    scale = -damping\n", "    scale = damping\n"),
            "the brake without a bound": (
                "    if damping * speed > parameters[LARGEST_CORRECTION_N]:", "    if False:",
            ),
            "the brake jumps": ("    if change > parameters[LARGEST_CHANGE_N]:", "    if False:"),
        },
    ),
    *faults(
        "rendering/environment.py",
        ("tests/render/test_render_environment.py",),
        {
            "the force of tissue pulls": (
                "force[i] = device_force * memory[NORMAL + i]",
                "force[i] = -device_force * memory[NORMAL + i]",
            ),
            "the motion is not scaled": (
                "depth = penetration / parameters[MOTION_SCALE] * gd.M_TO_MM",
                "depth = penetration * gd.M_TO_MM",
            ),
            "broken tissue is whole": ("        memory[BROKEN] = 1.0\n", "        pass\n"),
        },
    ),
    *faults(
        "haptics/falcon/packets.py",
        ("tests/haptics/test_haptics_falcon_packets.py",),
        {"a letter of another packet fits": ("    if not _fits(filled, byte):", "    if False:")},
    ),
    *faults(
        "haptics/falcon/kinematics.py",
        ("tests/haptics/test_haptics_falcon_kinematics.py",),
        {
            "torque in the wrong direction": ("    scale = -units_per_Nm\n", "    scale = units_per_Nm\n"),
            "motors without a clamp": ("    clipped = together > clamp_units\n", "    clipped = False\n"),
            "a clamp that is rounded up": (
                "out[i], left[i] = int(scale * torque[i]), 0.0",
                "out[i], left[i] = round(scale * torque[i] + 0.4), 0.0",
            ),
            "rounding that adds up beyond the clamp": (
                "    if clipped or square > clamp_units * clamp_units:\n", "    if clipped:\n",
            ),
            "what rounding left is forgotten": (
                "        left[i] = wanted - out[i]\n", "        left[i] = 0.0\n",
            ),
            "what rounding left is sent without a force": (
                "        left[0] = left[1] = left[2] = 0.0\n", "        pass\n",
            ),
            "a mirrored hand is believed": (
                "steps >= 0 and _knees_outward(found, angles, geometry):", "steps >= 0:",
            ),
        },
    ),
    *faults(
        "rendering/control/simulation.py",
        ("tests/render/test_render_control_law.py",),
        {
            "the controller without a bound": ("    if length > block.saturation_N:", "    if False:"),
            "the controller takes the hand twice": ("        total -= hand\n", "        total += hand\n"),
            "the reference runs away": ("vr = ve + rate * (xe - x)", "vr = ve - rate * (xe - x)"),
        },
    ),
    *faults(
        "haptics/falcon/servo_io.py",
        (f"{SESSIONS}_lasting_fault_in_contact_ends_in_fault_and_zero_packets[unplug-1-1]",),
        {
            "a lost device is silent": (
                "        if length <= 0:\n            parts.flags[LOST] = 1\n",
                "        if length <= 0:\n            length = 0\n",
            ),
            "homing mode is left": (
                "packets.encode_into(parts.motor, leds, True,",
                "packets.encode_into(parts.motor, leds, False,",
            ),
            "legs that move together are one alone": ("others > STILL_COUNTS", "others > 10 * ALONE_COUNTS"),
        },
    ),
    Mutant(
        "a leg that goes on alone is believed", "haptics/falcon/servo_io.py",
        "elif not found or _alone(parts.since, parts.last, counts):", "elif not found:",
        (f"{SESSIONS}_leg_that_counts_alone_is_a_fault_before_it_makes_a_force[3000.0]",),
    ),
    Mutant(
        "commands are never counted", "haptics/falcon/servo_io.py",
        "    parts.flags[UNANSWERED] += 1\n", "",
        (f"{SESSIONS}_late_wire_lights_its_lamp_and_lowers_the_force[4]",),
    ),
)  # fmt: skip

#: Caught by tests of the compiled loop alone.
COMPILED = (
    Mutant(
        "a pose that is none is believed", "haptics/falcon/servo_io.py",
        "elif not found or _alone(parts.since, parts.last, counts):",
        "elif _alone(parts.since, parts.last, counts):",
        ("tests/haptics/test_haptics_servo_drivers.py",),
    ),
    Mutant(
        "a dead owner unseen", "rendering/servo_loop.py",
        "        transition(servo.guard_memory, servo.limits, PARENT_DIED)\n", "        pass\n",
        ("tests/render/test_render_homing.py", "tests/render/test_render_servo_process.py"),
    ),
)  # fmt: skip
