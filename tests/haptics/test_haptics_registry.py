"""Devices and laws by name, a stand-in of an SDK, what the compiler refuses, and a process of our own."""

import ctypes
import os
import re
import subprocess
import sys
from dataclasses import replace
from importlib.metadata import EntryPoint, EntryPoints
from itertools import count
from pathlib import Path
from types import ModuleType, SimpleNamespace

import fake_device
import numba
import numpy as np
import pytest
from command_line import PACKAGES, REPOSITORY, python
from fake_device import FakeDevice
from guarded import FREE
from numba.core.errors import NumbaError
from rendered_tissues import PAPER_A, TWO_BRANCHES, pressed, walk

from tissueid.compiled import tick_kernel, tick_part
from tissueid.errors import DeviceError, UsageError
from tissueid.haptics import guard as machine
from tissueid.haptics import registry
from tissueid.haptics.device import AskedDevice, DetectedDevice, HapticDevice
from tissueid.haptics.falcon.packets import BUTTON_NAMES
from tissueid.haptics.forcedimension import device as driver
from tissueid.haptics.guard import guard, new_guard
from tissueid.haptics.sim import SimulatedDevice
from tissueid.haptics.states import Fault, State
from tissueid.own_process import own_process
from tissueid.rendering import servo_spawn
from tissueid.rendering.tissue_block import Plane, Tissue, tissue_block

PAGE = (REPOSITORY / "docs" / "devices.md").read_text(encoding="utf-8")

BROKEN = EntryPoint("broken", "no_such_distribution:Device", registry.DEVICE_GROUP)
NO_DEVICE = EntryPoint("nothing", "fake_device:law", registry.DEVICE_GROUP)
PLUGIN = EntryPoint("fake", "fake_device:FakeDevice", registry.DEVICE_GROUP)
THIEF = EntryPoint("sim", "fake_device:FakeDevice", registry.DEVICE_GROUP)
LAW = EntryPoint("spring", "fake_device:law", registry.ENVIRONMENT_GROUP)
NO_LAW = EntryPoint("number", "fake_device:RANGE", registry.ENVIRONMENT_GROUP)


@pytest.fixture
def plugins(monkeypatch):
    """Entry points as if distributions with them were installed."""
    installed = EntryPoints([BROKEN, NO_DEVICE, PLUGIN, THIEF, LAW, NO_LAW])
    monkeypatch.setattr(registry, "entry_points", installed.select)


def nothing_found(monkeypatch, note: str | None = None) -> None:
    """No hardware on this machine, or one with something in its way."""
    found = [] if note is None else [DetectedDevice("falcon", "/dev/bus/usb/001/004", note)]
    for name in registry.HARDWARE:
        kind, there = registry.device_class(name), found if name == "falcon" else []
        monkeypatch.setattr(kind, "detect", classmethod(lambda cls, there=there: there))


@pytest.mark.parametrize("name", registry.DEVICES)
def test_a_built_in_device_is_told_of_found_or_not_and_closed_until_it_is_opened(name):
    kind = registry.device_class(name)
    assert issubclass(kind, HapticDevice)
    assert kind.name == name
    assert f"\n| `{name}` |" in PAGE
    assert all(one.name == name for one in kind.detect())
    device = kind(**kind.configured(AskedDevice()))
    assert device.state is State.CLOSED
    assert device.compiled() is None or not registry.DEVICES[name].hardware
    with pytest.raises(DeviceError, match=f"^{name}: is closed"):
        device.write_force(np.zeros(3), 1e-3)
    low, high = np.array(kind.typical().workspace_m).T
    assert (high - low > 0.03).all()
    if registry.DEVICES[name].hardware:
        # until somebody weighed its force, with the button held
        assert device.limits.clamp_N <= 2.0
        assert device.limits.dead_man
        assert kind.typical().hardware
        assert not kind.typical().calibrated


def test_asking_for_names_imports_no_device():
    program = (
        "import sys\nfrom tissueid.haptics import registry\nregistry.device_names()\n"
        "print([m for m in sys.modules if 'falcon' in m or 'haptics.sim' in m or 'forcedim' in m])"
    )
    assert python("-c", program).stdout == "[]\n"


def test_a_device_of_another_distribution_is_found_and_takes_no_built_in_name(plugins):
    assert registry.device_class("fake") is FakeDevice
    assert registry.device_names()[-3:] == ["broken", "fake", "nothing"]
    assert registry.device_class("sim") is SimulatedDevice


def test_a_broken_plugin_says_what_broke_and_the_way_out(plugins):
    with pytest.raises(DeviceError, match=r"'broken'.*ModuleNotFoundError.*repair or remove"):
        registry.device_class("broken")
    with pytest.raises(DeviceError, match=r"'nothing'.*HapticDevice"):
        registry.device_class("nothing")


def test_a_broken_plugin_hides_no_other_device(plugins, monkeypatch):
    nothing_found(monkeypatch)
    found = {device.name: device for device in registry.detect_all()}
    assert {"sim", "fake", "broken", "nothing"} <= set(found)
    assert "ModuleNotFoundError" in found["broken"].note
    assert registry.choose_device() == registry.Choice("fake", "device fake: found at this test")


@pytest.mark.parametrize(
    ("note", "choice"),
    [
        (None, ("sim", "device sim, simulated: no haptic device was found")),
        ("", ("falcon", "device falcon: found at /dev/bus/usb/001/004")),
        ("no permission", ("sim", "device sim, simulated: falcon at /dev/bus/usb/001/004: no permission")),
    ],
)
def test_auto_takes_hardware_with_nothing_in_its_way_else_the_simulated_one_and_says_why(
    monkeypatch, note, choice
):
    nothing_found(monkeypatch, note)
    assert registry.choose_device() == registry.Choice(*choice)


def test_a_device_named_by_the_user_is_never_replaced(monkeypatch):
    nothing_found(monkeypatch)
    assert registry.choose_device("falcon") == registry.Choice("falcon", "device falcon: asked for by name")
    with pytest.raises(UsageError, match=r"no device named 'flacon'.*falcon, forcedimension.*sim.*auto"):
        registry.choose_device("flacon")


def test_a_force_law_of_another_distribution_is_found(request):
    with pytest.raises(UsageError, match="installed: none"):
        registry.environment_law("magnet")
    request.getfixturevalue("plugins")
    assert registry.environment_law("spring") is fake_device.law
    with pytest.raises(UsageError, match=r"'magnet'.*number, spring.*tissueid\.environments"):
        registry.environment_law("magnet")
    with pytest.raises(DeviceError, match=r"'number'.*tuple, not a function"):
        registry.environment_law("number")


class Driver:
    """The page's my_driver."""

    pushed: tuple[float, ...] | None = None
    height_m = 0.13

    def read(self) -> tuple[list[float], int]:
        return [0.0, 0.0, self.height_m], 4

    def push(self, *force: float) -> None:
        self.pushed = force

    def close(self) -> None:
        pass


def test_plug_in_of_the_page_runs_behind_the_guard(monkeypatch):
    driver = Driver()
    module = ModuleType("my_driver")
    module.open = lambda: driver
    module.places = lambda: ["/dev/input/js0"]
    monkeypatch.setitem(sys.modules, "my_driver", module)
    (block,) = re.findall(r"^```python\n(.*?)^```$", PAGE, flags=re.MULTILINE | re.DOTALL)
    found: dict[str, object] = {}
    exec(compile(block, "joystick.py", "exec"), found)
    kind, ticks = found["Joystick"], count()
    found["time"] = SimpleNamespace(monotonic=lambda: 1e-3 * next(ticks))
    assert isinstance(kind, type)
    assert issubclass(kind, HapticDevice)
    assert [one.where for one in kind.detect()] == ["/dev/input/js0"]
    with kind() as device:
        for _ in range(60):
            device.read()
            device.write_force(np.array([0.0, 0.0, 50.0]), 1e-3)
        assert device.state is State.ARMED
        assert driver.pushed == (0.0, 0.0, 0.0)
        assert device.compiled() is None
        # a grip that moves is not frozen, without encoders too; one that stands while the force changes is
        device.engage()
        for tick in range(2000):
            driver.height_m = 0.13 - 2e-5 * tick
            device.read()
            device.write_force(np.array([0.0, 0.0, 0.1 if tick < 500 else 1.0]), 1e-3)
        assert (device.fault, driver.pushed) == (Fault.NONE, (0.0, 0.0, 1.0))
        for _ in range(400):
            device.read()
            device.write_force(np.array([0.0, 0.0, 0.5]), 1e-3)
        assert device.fault is Fault.ENCODER_FROZEN
    assert 'tissueid.devices"]' in PAGE


KINDS = pytest.mark.parametrize("compiled", [tick_kernel, tick_part])


def allocates(values):
    return np.zeros(3)[0] + values[0]


def doubles_in_place(values):
    for i in range(values.size):
        values[i] *= 2.0
    return values[values.size - 1]


@pytest.mark.needs_jit
@KINDS
def test_a_function_that_allocates_is_not_compiled(compiled):
    # nothing else is wrong with it
    assert numba.njit(allocates)(np.ones(3)) == 1.0
    with pytest.raises(NumbaError, match="zeros"):
        compiled(allocates)(np.ones(3))


@KINDS
def test_a_function_works_on_the_array_of_its_caller(compiled):
    values = np.array([1.0, 2.0, 4.0])
    assert compiled(doubles_in_place)(values[1:]) == 8.0
    assert values.tolist() == [1.0, 4.0, 8.0]


def test_scipy_is_out_of_reach_only_while_numba_sets_itself_up():
    program = (
        "import importlib.util, sys\n"
        "from tissueid.compiled import without_scipy\n"
        "from tissueid.haptics.guard import new_guard, transition\n"
        "from tissueid.haptics.guard import SHUT\n"
        "from tissueid.haptics.limits import GuardLimits\n"
        "with without_scipy():\n"
        "    transition(new_guard(), GuardLimits().block(), SHUT)\n"
        "print([name for name in sys.modules if name.startswith('scipy.linalg')])\n"
        "import scipy.linalg\n"
        "with without_scipy():\n"
        "    print(sys.modules['scipy.linalg'] is scipy.linalg)\n"
    )
    assert python("-c", program).stdout == "[]\nTrue\n"


HERE = Path(__file__).resolve().parent
REFERENCE = REPOSITORY / "benchmarks" / "servo_reference.c"
TICKS, SAMPLES, SEED = 4000, 1500, 4
SHAKEN = replace(FREE, clamp_N=4.0, rms_limit_N=2.5, rms_window_s=0.5)

IN_PYTHON = "import sys; import test_haptics_registry as here; here.save(sys.argv[1])"


def guarded(step, seed: int) -> np.ndarray:
    """Everything the guard sent and remembers, over a session with stalls, releases, ramps and a fault."""
    rng = np.random.default_rng(seed)
    limits, memory = SHAKEN.block(), new_guard()
    memory[machine.STATE], memory[machine.READY] = machine.ARMED, 1.0
    force, out = np.zeros(3), np.zeros(3)
    seen = np.zeros((TICKS, 3 + memory.size))
    for k in range(TICKS):
        force += 0.6 * rng.standard_normal(3)
        memory[machine.VELOCITY : machine.VELOCITY + 3] = 0.2 * rng.standard_normal(3)
        if k % 900 == 600:
            memory[machine.PHASE] = machine.RELEASING
        if k == TICKS - 100:
            force[1] = np.nan
        dt = 1e-3 * (1.0 + 0.3 * rng.standard_normal()) if k % 401 else 0.04
        step(memory, limits, force, dt, out)
        seen[k, :3], seen[k, 3:] = out, memory
    return seen


def forces_of(tissue: Tissue) -> np.ndarray:
    """Forces on presses, releases faster than the tissue follows, in air, and beyond what was identified."""
    times = np.cumsum(np.random.default_rng(2).uniform(2e-4, 3e-3, SAMPLES))
    depth = 4.0 * np.sin(9.0 * times) + 3.0 * np.sin(2.0 * times) + 2.5 * np.sin(40.0 * times)
    block = tissue_block(tissue, Plane(), force_scale=1.0, motion_scale=1.0)
    return walk(block, pressed(depth, motion=1.0), times)[1][:, 3]


def everything() -> dict[str, np.ndarray]:
    return {"guard": guarded(guard, SEED), **{one.name: forces_of(one) for one in (PAPER_A, TWO_BRANCHES)}}


def save(path: str) -> None:
    np.savez(path, **everything())


@pytest.mark.needs_jit
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_numba_and_c_agree_bit_for_bit(tmp_path, c_library, seed):
    library = c_library(REFERENCE, tmp_path, "-O2", "-ffp-contract=off")
    reference = ctypes.CDLL(str(library)).reference_guard
    array = np.ctypeslib.ndpointer(np.float64, flags="C")
    reference.argtypes, reference.restype = [array, array, array, ctypes.c_double, array], None
    ours = guarded(guard, seed)
    assert ours.tobytes() == guarded(reference, seed).tobytes()
    # the session shows what it is to show: force, ramps, the sustained limit, a fault
    lamps = np.bitwise_or.reduce(ours[:, 3 + machine.LAMPS].astype(int))
    assert lamps & 0b1_0110_0011 == 0b1_0110_0011
    assert ours[-1, 3 + machine.STATE] == machine.FAULTED


@pytest.mark.needs_jit
def test_numba_and_plain_python_agree_bit_for_bit(tmp_path):
    there = tmp_path / "python.npz"
    folders = os.pathsep.join(map(str, (HERE, HERE.parent, PACKAGES)))
    python("-c", IN_PYTHON, there, NUMBA_DISABLE_JIT="1", PYTHONPATH=folders)
    found, plain = everything(), np.load(there)
    for name, one in found.items():
        assert plain[name].tobytes() == one.tobytes(), name
    for tissue in (PAPER_A, TWO_BRANCHES):
        assert (found[tissue.name] > 0.0).sum() > SAMPLES // 4
        assert (found[tissue.name] == 0.0).sum() > SAMPLES // 10


def test_sdk_is_looked_for_where_its_documentation_puts_it(monkeypatch, tmp_path):
    monkeypatch.delenv(driver.LIBRARY_VARIABLE, raising=False)
    monkeypatch.setattr("tissueid.haptics.forcedimension.device.platform.machine", lambda: "x86_64")
    for name, folder in (("HOME", tmp_path), ("FDSDK", "/opt/fd"), ("FORCEDIM_SDK", "/opt/other")):
        monkeypatch.setenv(name, str(folder))
    places = list(driver.candidates())
    assert places[0] == "/opt/fd/lib/release/lin-x86_64-gcc/libdrd.so"
    assert "/opt/other/lib/release/lin-x86_64-gcc/libdrd.so" in places
    assert places.index(f"{tmp_path}/.local/lib/libdrd.so") < places.index("/usr/local/lib/libdrd.so")
    monkeypatch.setenv(driver.LIBRARY_VARIABLE, "/mine/libdrd.so")
    assert list(driver.candidates()) == ["/mine/libdrd.so"]


@pytest.mark.parametrize(
    ("library_name", "stub", "reason"),
    [
        ("none.so", {}, r"not installed.* FDSDK .*TISSUEID_FORCEDIM"),
        ("libc.so.6", {}, "has no dhdGetSDKVersion"),
        (None, {"major": 2}, r"is 2\.17\.5\.1; 3\.16 or newer"),
        (None, {"fails": 1}, "no device found"),
    ],
)
def test_without_an_sdk_of_use_nothing_is_detected_and_opening_says_why(
    sdk, monkeypatch, library_name, stub, reason
):
    for name, value in stub.items():
        sdk[name] = value
    if library_name is not None:
        monkeypatch.setenv(driver.LIBRARY_VARIABLE, library_name)
    assert driver.ForceDimensionDevice.detect() == []
    with pytest.raises(DeviceError, match=reason):
        driver.ForceDimensionDevice().open()


def test_axes_are_mapped_once_and_back(sdk):
    # ours: x right, y up, z to the user; theirs: x to the user, y right, z up
    assert pytest.approx(np.eye(3)) == driver.ROTATION @ driver.ROTATION.T
    assert np.linalg.det(driver.ROTATION) == pytest.approx(1.0)
    sdk.move(0.01, 0.02, 0.03)
    with driver.ForceDimensionDevice() as device:
        assert device.read().position_m == pytest.approx([0.02, 0.03, driver.ORIGIN_M[2] + 0.01])
        device._write(np.array([1.0, 2.0, 3.0]))
        assert sdk["force"] == pytest.approx([3.0, 1.0, 2.0])


def test_opening_switches_gravity_off_and_motors_on_under_the_clamp(sdk):
    (found,) = driver.ForceDimensionDevice.detect()
    assert (found.name, found.note, sdk["open"]) == ("forcedimension", "", 0)
    with driver.ForceDimensionDevice():
        assert (sdk["gravity"], sdk["forces_on"], sdk["max_force"], sdk["open"]) == (0, 1, 2.0, 1)
    assert (sdk["stopped"], sdk["open"], sdk["force"]) == (1, 0, [0.0, 0.0, 0.0])


def test_homing_waits_for_the_drivers_flag_and_no_longer_than_told(sdk, monkeypatch):
    monkeypatch.setattr("tissueid.haptics.device.TICK_S", 0.0)
    with driver.ForceDimensionDevice(homing_timeout_s=0.05) as device:
        with pytest.raises(DeviceError, match="homing never completed"):
            device.home()
        sdk["homed"] = 1
        # a busy machine takes its time for fifty readings
        device._homing_timeout_s = 10.0
        device.home()
        assert device.state is State.ARMED


def test_answers_short_of_failure_are_taken_and_a_lost_device_is_an_error(sdk):
    with driver.ForceDimensionDevice() as device:
        for code in (1, 2, 0):
            sdk["code"] = code
            assert device.read().valid
        sdk["fails"] = 1
        with pytest.raises(DeviceError, match="dhdGetPosition failed: no device found"):
            device.read()


def test_buttons_are_those_of_the_wire_and_centre_is_the_dead_mans(sdk):
    bits = {name: bit for bit, name in BUTTON_NAMES.items()}
    # in the order of the SDK's bits
    order = [bits[name] for name in ("centre", "minus", "forward", "plus")]
    with driver.ForceDimensionDevice() as device:
        for mask in range(16):
            sdk["buttons"] = mask
            assert device.read().buttons == sum(bit for k, bit in enumerate(order) if mask >> k & 1)
        assert device.limits.dead_man_buttons == bits["centre"]
        assert device.limits.dead_man


@pytest.fixture
def other_checkout(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with another ``tissueid`` in it, which one stands in."""
    package = tmp_path / "tissueid"
    package.mkdir()
    (package / "__init__.py").write_text("raise SystemExit('the wrong files')\n", encoding="ascii")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_a_checkout_one_stands_in_is_not_what_runs(other_checkout: Path) -> None:
    by_module = [sys.executable, "-m", "tissueid.haptics.falcon.emulator", "--help"]
    assert "the wrong files" in subprocess.run(by_module, capture_output=True, text=True, check=False).stderr
    ours = own_process("tissueid.haptics.falcon.emulator", "--help")
    shown = subprocess.run(ours, capture_output=True, text=True, check=False)
    assert shown.returncode == 0, shown.stderr
    assert "--until-eof" in shown.stdout


def test_the_servo_beside_another_checkout_is_ours(other_checkout: Path) -> None:
    servo = servo_spawn.spawn_servo()
    # one that can't be loaded ends at once, ours waits for its plan
    with pytest.raises(subprocess.TimeoutExpired):
        servo.process.wait(1.0)
    servo.close()


def test_modules_beside_a_script_stay_reachable(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "beside.py").write_text("import sys\nprint(sys.argv[1:], __name__)\n", encoding="ascii")
    monkeypatch.syspath_prepend(str(tmp_path))
    shown = subprocess.run(own_process("beside", "a", "b"), capture_output=True, text=True, check=True)
    assert shown.stdout.split() == ["['a',", "'b']", "__main__"]
