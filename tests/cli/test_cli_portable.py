"""Without modules of POSIX, and without libraries of the extras: recordings are read, fitted and exported."""

import os

import pytest
from command_line import REPOSITORY, python

from tissueid.extras import EXTRA_OF

HOLD = REPOSITORY / "datasets_synthetic" / "paper-a-hold-100Hz"
#: What Python on Windows lacks.
POSIX = ("fcntl", "termios", "resource", "pwd", "grp", "tty", "pty", "posix_ipc", "readline")
#: Every library that only an extra brings, and the one that only an installation is built with.
EXTRAS = (*EXTRA_OF, "plotly")
#: Neither they nor what an installation notes of them are found.
HIDING = """
import importlib.metadata, os, sys
hidden, known = os.environ["HIDDEN_MODULES"].split(","), importlib.metadata.distribution
sys.modules.update(dict.fromkeys(hidden))

def distribution(name):
    if name in hidden:
        raise importlib.metadata.PackageNotFoundError(name)
    return known(name)

importlib.metadata.distribution = distribution
"""


@pytest.fixture(scope="module")
def hide(tmp_path_factory):
    """Function that runs an interpreter, and all that it starts, without some modules."""
    place = tmp_path_factory.mktemp("hiding")
    (place / "sitecustomize.py").write_text(HIDING)

    path = os.pathsep.join([str(place), str(REPOSITORY)])
    return lambda modules, *arguments: python(
        *arguments, check=False, HIDDEN_MODULES=",".join(modules), PYTHONPATH=path
    )


@pytest.fixture(scope="module", params=[POSIX, EXTRAS], ids=["posix", "extras"])
def fitted(request, hide, tmp_path_factory):
    """Modules that are hidden, and the folder of a fit without them."""
    out = tmp_path_factory.mktemp("portable") / "out"
    few = ("--branches", "1", "--stiffness-degree", "0", "--draws", "100")
    done = hide(request.param, "-m", "tissueid", "fit", HOLD, "-o", out, *few)
    assert done.returncode == 0, done.stderr
    assert "viscosity" in done.stdout
    return request.param, out


def test_recordings_are_inspected_and_a_fit_is_reported_validated_and_exported_without_them(fitted, hide):
    modules, out = fitted
    done = hide(modules, "-m", "tissueid", "inspect", HOLD)
    assert (done.returncode, done.stderr) == (0, "")
    assert "265.9 N at 8 mm" in done.stdout
    (out / "report.html").unlink()
    for arguments in (["report", out], ["validate", out], ["export", out, "--format", "specimens"],
                      ["export", out, "--format", "c-header"], ["models"], ["devices", "list"]):  # fmt: skip
        done = hide(modules, "-m", "tissueid", *arguments)
        assert done.returncode == 0, (arguments, done.stderr)
    assert "Plotly" in (out / "report.html").read_text()


def test_a_simulated_device_is_felt_without_posix(fitted, hide):
    modules, out = fitted
    done = hide(modules, "-m", "tissueid", "render", out / "bundle.h5", "--device", "sim", "--seconds", "0.3")
    if modules is POSIX:
        assert done.returncode == 0, done.stderr
        assert "not compiled yet" in done.stderr or "period error" in done.stderr
    else:
        assert done.returncode == 2
        assert "pip install 'tissueid[haptics]'" in done.stderr
        assert "Traceback" not in done.stderr


@pytest.mark.parametrize(
    ("arguments", "extra"),
    [(["inspect", HOLD, "--serve", "--no-browser"], "viewer"), (["render", "--selftest"], "haptics")],
)
def test_a_missing_extra_is_said_with_the_line_that_installs_it(hide, arguments, extra):
    done = hide(EXTRAS, "-m", "tissueid", *arguments)
    assert done.returncode == 2, done.stderr
    assert f"pip install 'tissueid[{extra}]'" in done.stderr
    assert "Traceback" not in done.stderr


def test_packets_and_kinematics_of_the_falcon_need_no_extra(hide):
    done = hide(
        (*EXTRAS, *POSIX),
        "-c",
        "from tissueid.haptics.falcon.kinematics import inverse, forward, torque\n"
        "from tissueid.haptics.falcon.packets import PacketParser, encode_command\n"
        "import numpy as np\n"
        "where = np.array([0.01, -0.02, 0.13])\n"
        "assert np.allclose(forward(inverse(where)), where, atol=1e-9)\n"
        "assert torque(where, [0.0, 0.0, 1.0]).shape == (3,)\n"
        "PacketParser().feed(encode_command([0, 0, 0], leds=0, homing=True))\n",
    )
    assert (done.returncode, done.stderr) == (0, "")
