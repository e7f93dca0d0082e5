"""Every exit code of the table, end to end, and which one wins."""

from __future__ import annotations

import errno
import os
import shutil
from unittest.mock import Mock

import pytest
from command_line import LOG, QUICK, run, write_log

from tissueid.errors import exit_code
from tissueid.ingest import RECIPES
from tissueid.store import files
from tissueid.store.outputs import OutputSet


@pytest.fixture(scope="module")
def two_outs(fitted_once, tmp_path_factory):
    """Two finished fits of two different logs."""
    folder = tmp_path_factory.mktemp("outs")
    shutil.copytree(fitted_once / "out", folder / "one", symlinks=True)
    log = write_log(folder / "two.csv", force_times=1.3)
    assert run("fit", log, "-o", folder / "two", *QUICK).code in (0, 4)
    return folder / "one", folder / "two"


@pytest.fixture
def junk(tmp_path):
    path = tmp_path / "junk.csv"
    path.write_bytes(bytes(range(256)) * 8)
    return path


PRESET = ("control", "--preset", "paper-a")
CALIBRATE = ("calibrate", "paper-a-30", "-o", "out")
FIT = ("fit", "log.csv", "--model")


@pytest.mark.parametrize(
    ("args", "said"),
    [
        (["fit", "--no-such-flag", "x"], "No such option"),
        (["inspcet", "x"], "Did you mean 'inspect'?"),
        (["zzzz"], "No such command"),
        (["inspect", "nowhere.csv"], "nowhere.csv"),
        (["fit", "nowhere/", "-o", "out"], "nowhere"),
        (["fit"], "Missing argument"),
        (["validate", "nowhere"], "nowhere"),
        (["report", "nowhere"], "nowhere"),
        (["export", "nowhere"], "nowhere"),
        (["synth", "no-such-recipe", "-o", "out"], "paper-a-30"),
        (["synth", "no-such-recipe.toml", "-o", "out"], "no-such-recipe.toml"),
        (["synth", "paper-a-22", "-o", "out", "--rate", "0"], "--rate"),
        (["synth", "paper-a-22", "-o", "out", "--rate", "nan"], "--rate"),
        (["synth", "paper-a-22", "-o", "out", "--seed", "-1"], "--seed"),
        (["synth", "paper-a-22", "-o", "out", "--dialect", "klingon"], "klingon"),
        (["fit", "x", "--branches", "4"], "--branches"),
        (["fti"], "Did you mean 'fit'?"),
        (["reports"], "Did you mean 'report'?"),
        (["valdate"], "Did you mean 'validate'?"),
        (["export", ".", "--specimen", "a"], "leave it out"),
        (["export", ".", "--format", "c-header", "--depth", "3"], "leave it out"),
        (["export", __file__, "--format", "trials"], "from the whole output folder"),
        (["control"], "give a bundle, or --preset, and not both"),
        (["control", "--preset", "nonsense"], "there is no preset 'nonsense'"),
        ([*PRESET, "--virtual-mass", "0.3"], "variant B bears from 0.396 kg on; take 0.594 kg"),
        ([*PRESET, "--variant", "A", "--virtual-mass", "1.2"], "or variant B"),
        ([*PRESET, "--interface", "0", "1", "1"], "the device needs a mass"),
        ([*PRESET, "--kr", "4000"], "overshoots within one sample"),
        (["calibrate", "nowhere"], "no such file, folder or recipe; recipes are paper-a-22"),
        ([*CALIBRATE, "--rate", "0"], "--rate is 0.0"),
        ([*CALIBRATE, "--phi", "0.9"], "--phi is the correlation of --noise ar1"),
        ([*CALIBRATE, "--noise", "ar1"], "needs its correlation here: add --phi"),
        ([*CALIBRATE, "--simulations", "3"], "3 is not in the range x>=20"),
        (["watch", "nowhere"], "there is no such folder"),
        ([*FIT, "cubic * prony"], "there are exponential, flat"),
        ([*FIT, "prony"], "STATIC * [STIFFNESS *] RELAXATION"),
        ([*FIT, "polynomial * prony:7"], "7 branches"),
        ([*FIT, "polynomial * prony", "--branches", "2"], "says it already"),
        (["reproduce", "shakespeare"], "sadeghnejad"),
        (["reproduce", "pires", "--set", "surface=torus"], "hyperboloid, cone"),
        (["reproduce", "pires", "-o", "/dev/null/out"], "choose another folder"),
    ],
)
def test_wrong_usage_is_2(args, said, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    run(*args, code=2, said=said)
    # nothing is made for nothing
    assert list(tmp_path.iterdir()) == []


#: Options of reading, and of a fit, that can't be understood.
READING = [
    ("--columns zeit=t", "--columns"),
    ("--columns time", "--columns"),
    ("--units force=blorb", "blorb"),
    ("--specimen-by (", "not a regular expression"),
    ("--recipe nope", tuple(RECIPES)),
    ("--contact nan", "--contact"),
    ("--contact deep", "--contact"),
    ("--compression up", "--compression"),
]
FITTING = [
    ("--frequencies 0.1;1", "--frequencies"),
    ("--frequencies 0,1", "--frequencies"),
    ("--depths deep", "--depths"),
    ("--tip sphere", "sphere:3"),
    ("--tip pyramid:3", "not offered"),
    ("--tip cone:95", "half angle"),
    ("--thickness 5", "--tip"),
    ("--tip flat:2 --thickness -5", "thickness"),
    ("--tip flat:2 --poisson 0.6", "0.6"),
]


@pytest.mark.parametrize(
    ("command", "args", "said"),
    [*(("inspect", *row) for row in READING), *(("fit", *row) for row in (*READING, *FITTING))],
)
def test_an_option_that_cannot_be_understood_is_2(tmp_path, command, args, said):
    log, out = write_log(tmp_path / "log.csv"), tmp_path / "out"
    run(command, log, *args.split(), *(("-o", out) if command == "fit" else ()), code=2, said=said)
    assert not out.exists()


def test_a_reader_that_is_none_is_2_in_a_folder_that_knows_the_recording(tmp_path):
    log, out = write_log(tmp_path / "log.csv"), ("-o", tmp_path / "out")
    run("fit", log, "--columns", "time=nope", *out, code=3)
    run("fit", log, "--recipe", "nope", *out, code=2, said=tuple(RECIPES))


def test_all_inputs_refused_is_3_and_the_old_set_stays(two_outs, junk):
    before = (two_outs[0] / "identification.json").read_bytes()
    document = run("fit", junk, "-o", two_outs[0], "--json", code=3).json()
    assert (document["exit"]["code"], document["specimens"]) == (3, [])
    assert (two_outs[0] / "identification.json").read_bytes() == before
    assert run("validate", two_outs[0]).code == 0
    assert run("inspect", junk).code == 3


def test_a_recipe_that_is_none_is_3(tmp_path):
    (tmp_path / "r.toml").write_text("rate_Hz = 'fast'", encoding="utf-8")
    run("synth", tmp_path / "r.toml", "-o", tmp_path / "out", code=3, said="r.toml")


def test_a_required_parameter_that_is_not_identified_is_4(datasets, tmp_path):
    logs = sorted((datasets / "paper-a-30-10Hz").glob("hold-[48]-*.csv"))
    # viscosity and static curve are identified at 10 Hz, and they are what is required by default
    for required, code in (("relaxation-time",), 4), ((), 0), (("none",), 0):
        asked = [word for name in required for word in ("--require", name)]
        run("fit", *logs, "-o", tmp_path, "-q", *QUICK, *asked, code=code)


def test_a_damaged_bundle_is_6(two_outs, tmp_path):
    whole = (two_outs[0] / "bundle.h5").read_bytes()
    broken = tmp_path / "broken.h5"
    broken.write_bytes(whole[: len(whole) // 2])
    run("validate", broken, code=6, said="broken.h5")
    out = shutil.copytree(two_outs[0], tmp_path / "out")
    (out / "bundle.h5").write_bytes(whole[:-1] + bytes([whole[-1] ^ 1]))
    assert run("validate", out).code == 6


def test_a_mixed_set_is_6(two_outs, tmp_path):
    out = shutil.copytree(two_outs[0], tmp_path / "out")
    (out / "report.html").write_bytes((two_outs[1] / "report.html").read_bytes())
    run("validate", two_outs[1], out, code=6, said="report.html", shown=f"{two_outs[1]}: valid")


@pytest.mark.parametrize("command", ["validate", "report", "export", "cohort"])
def test_a_folder_without_a_run_is_6(tmp_path, command):
    run(command, tmp_path, code=6, said=("no finished run", "tissueid fit"))


def test_a_second_writer_is_6(tmp_path):
    log = write_log(tmp_path / "log.csv")
    with OutputSet(tmp_path):
        run("fit", log, "-o", tmp_path, *QUICK, code=6, said="is writing here")


def test_precedence_of_codes_is_that_of_the_table():
    order = [1, 2, 3, 6, 5, 7, 4, 0]
    for index, first in enumerate(order):
        assert exit_code(set(order[index:])) == first


def caused(error: BaseException, cause: BaseException) -> BaseException:
    error.__cause__ = cause
    return error


#: An interrupt, also where a compiled kernel wraps it.
INTERRUPTS = (KeyboardInterrupt(), caused(SystemError("with an exception set"), KeyboardInterrupt()))


@pytest.mark.parametrize(
    ("error", "code", "said"),
    [
        (ZeroDivisionError("for the test"), 1, "tissueid: internal error (ZeroDivisionError: for the test)."),
        (OSError(errno.EIO, "the disk is gone", "here"), 6, "tissueid: here: the disk is gone\n"),
        *((one, 130, "tissueid: interrupted; what was finished is kept\n") for one in INTERRUPTS),
    ],
)
def test_an_internal_error_is_1_in_one_line_an_output_that_fails_6_and_an_interrupt_130(
    monkeypatch, tmp_path, error, code, said
):
    monkeypatch.setattr("tissueid.study.inspected.describe_segmented", Mock(side_effect=error))
    ended = run("inspect", write_log(tmp_path / "log.csv"), code=code)
    assert ended.stdout == ""
    assert ended.stderr.lstrip("\n").startswith(said)


def test_a_full_disk_is_6_and_no_bug(monkeypatch, tmp_path):
    full = OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), "here")
    monkeypatch.setattr(files.Path, "write_bytes", Mock(side_effect=full))
    run("fit", write_log(tmp_path / "log.csv"), "-o", tmp_path / "out", *QUICK, code=6, said=full.strerror)


def test_a_report_that_is_not_ours_is_not_overwritten(tmp_path):
    (tmp_path / "report.html").write_text("mine", encoding="utf-8")
    run("fit", LOG, "-o", tmp_path, code=2, said="report.html")
    assert (tmp_path / "report.html").read_text(encoding="utf-8") == "mine"
