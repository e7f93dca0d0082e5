"""Folders as they are: damaged files among sound ones, odd names, other locales, missing rights."""

from __future__ import annotations

import ctypes
import json
import os
import subprocess
import sys
import unicodedata
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from command_line import QUICK, Ended, log_text, python, read_json, run, start, write_log, write_study

from tissueid.synth import DIALECTS, Hold, Log, Move, SyntheticLog, bluehill_csv, recipe, simulate

linux_only = pytest.mark.skipif(sys.platform != "linux", reason="rights and names of a POSIX system")


def test_thirty_sound_logs_are_fitted_and_eight_others_named_with_reasons_and_lines(tmp_path):
    folder, out, repeats = tmp_path / "lab", tmp_path / "out", 5
    sound = write_lab(folder, repeats=repeats)
    log = sound_logs(repeats)[0]
    ended = run("fit", folder, "-o", out, *QUICK, code=7)
    lines = ended.stderr.splitlines()
    for name, (_, line, word) in damaged_files(log).items():
        place = str(folder / name) if line is None else f"{folder / name}, line {line}"
        (said,) = (text for text in lines if name in text)
        assert place in said
        assert word in said
    for name, (_, word) in unidentifiable_files(log).items():
        # what was read and fitted goes by the name of its specimen
        start_of_line = "ramp: not identified: " if word == "not identified" else f"refused ({word}"
        said = [text for text in lines if text.startswith(start_of_line) and (name in text or "ramp" in name)]
        assert said
        assert all(word in text for text in said)
    document = read_json(out / "identification.json")
    assert document["exit"]["code"] == 7
    used = [entry["path"] for entry in document["provenance"]["inputs"]]
    assert len(used) == sound + 1
    assert len(document["refused"]) == len(damaged_files(log)) + 2
    identified = {one["specimen"] for one in document["specimens"]} - {"ramp"}
    assert identified == {f"paper-a-{k:02d}" for k in (1, 2, 3)}
    assert sound == 30
    assert "paper-a-02  10 logs" in ended.stdout


def test_many_specimens_that_are_not_identified_are_all_named(tmp_path, monkeypatch, capfd):
    from types import SimpleNamespace

    from tissueid.cli import fit_command

    reasons = tuple(f"cow {k}: not identified: viscosity_Ns_per_mm" for k in range(40))
    reasons += ("goat: not identified: static_N_per_mm", "cow 7: Levenberg-Marquardt did not converge")
    ended = SimpleNamespace(refused=(), exit=SimpleNamespace(reasons=reasons))
    fit_command.print_reasons(ended, quiet=0)  # type: ignore[arg-type]
    said = capfd.readouterr().err
    assert all(f"cow {k};" in said or f"cow {k}:" in said for k in range(40))
    assert said.count("viscosity_Ns_per_mm") == 1
    assert "goat: not identified: static_N_per_mm" in said
    assert "cow 7: Levenberg-Marquardt did not converge" in said


NAMES = {
    "space": "my log 1.csv",
    "composed": unicodedata.normalize("NFC", "Hüfte é.csv"),
    "decomposed": unicodedata.normalize("NFD", "Hüfte é.csv"),
    "emoji": "🐄 log 👩\u200d🔬.csv",
    "right to left": "كلية ١.csv",
    "override": "a\u202evsc.csv",
    "line break": "two\nlines.csv",
    "tab": "a\tb.csv",
    "escape": "\x1b[31mred.csv",
    "markup": "[bold]{x} %s $HOME `id`.csv",
    "html": "<script>alert(1)&amp;.csv",
    "quote": "a'b\"c.csv",
    "dash": "-v.csv",
    "long": "x" * 240 + ".csv",
    "no stem": "..csv",
}


@linux_only
def test_files_of_any_name_are_read_fitted_reported_and_validated(tmp_path):
    folder, out = tmp_path / "Ünï 🐄 lab", tmp_path / "oút put"
    folder.mkdir()
    logs = {name: text for name, text in NAMES.items() if not text.startswith(".")}
    for text in logs.values():
        (folder / text).write_text(log_text(label=None, stride=16), encoding="ascii")
    inspected = run("inspect", folder, "--json", code=0)
    assert sorted(one["path"] for one in inspected.json()) == sorted(str(folder / n) for n in logs.values())
    few = [folder / NAMES[key] for key in ("composed", "decomposed", "emoji", "line break", "html", "long")]
    run("fit", *few, "-o", out, *QUICK, code={0, 4})
    document = read_json(out / "identification.json")
    # names that differ in nothing but their normal form are two files and two specimens
    assert len({one["specimen"] for one in document["specimens"]}) == len(few)
    assert run("validate", out).code == 0
    assert "<script>alert" not in (out / "report.html").read_text(encoding="utf-8")
    assert run("report", out).code == 0


@linux_only
def test_a_name_that_is_no_unicode_is_refused_and_the_others_are_read(tmp_path):
    bad = os.fsdecode(bytes(tmp_path) + b"/caf\xe9.csv")
    Path(bad).write_text(log_text(), encoding="ascii")
    write_log(tmp_path / "good.csv")
    for args in ([], ["--json"]):
        ended = run("inspect", tmp_path, *args, code=7)
        assert "UTF-8" in ended.stderr + ended.stdout
    assert run("fit", tmp_path, "-o", tmp_path / "out", *QUICK).code == 7


@pytest.fixture(scope="module")
def comma_locale(tmp_path_factory):
    """Environment in which a locale with a decimal comma is installed; compiled for the test where needed."""
    names = ("de_DE.UTF-8", "de_DE.utf8", "fr_FR.UTF-8", "fr_FR.utf8")
    installed = subprocess.run(["locale", "-a"], capture_output=True, text=True, check=False).stdout.split()
    for name in names:
        if name in installed:
            return {"LC_ALL": name}
    folder = tmp_path_factory.mktemp("locales")
    target = folder / "de_DE.UTF-8"
    try:
        made = ["localedef", "-i", "de_DE", "-f", "UTF-8", str(target)]
        subprocess.run(made, capture_output=True, check=False, timeout=60)
    except OSError:
        pytest.skip("no locale with a decimal comma is installed, and there is no localedef to compile one")
    if not target.is_dir():
        pytest.skip("no locale with a decimal comma is installed, and none could be compiled")
    return {"LC_ALL": "de_DE.UTF-8", "LOCPATH": str(folder)}


WITH_LOCALE = """
import json, locale, sys
locale.setlocale(locale.LC_ALL, "")
assert locale.localeconv()["decimal_point"] == sys.argv[1], locale.localeconv()["decimal_point"]
from tissueid.cli.main import main
sys.exit(main(sys.argv[2:]))
"""


@pytest.mark.slow
@linux_only
def test_a_locale_with_a_decimal_comma_changes_no_number(tmp_path, comma_locale):
    write_log(tmp_path / "lab" / "points.csv", stride=8)
    text = log_text(label="other", stride=8, force_times=1.2)
    head, body = text.split("(N)\n")
    commas = (head + "(N)\n").replace(",", ";") + body.replace(",", ";").replace(".", ",")
    (tmp_path / "lab" / "commas.csv").write_text(commas, encoding="ascii")
    args = ["fit", str(tmp_path / "lab"), *QUICK, "--json", "-o"]
    ended = python("-c", WITH_LOCALE, ",", *args, tmp_path / "commas", check=False, **comma_locale)
    assert ended.returncode in (0, 4), ended.stderr
    assert run("validate", tmp_path / "commas").code == 0
    there, here = json.loads(ended.stdout), run(*args, tmp_path / "points").json()
    assert there["specimens"] == here["specimens"]
    assert there["provenance"]["inputs"] == here["provenance"]["inputs"]
    assert len(here["specimens"]) == 2


def _drop_superuser() -> None:
    """Let rights bind the superuser too: after exec the process may no longer pass over them."""
    library = ctypes.CDLL(None, use_errno=True)
    drop_bound, override, search = 24, 1, 2
    for capability in (override, search):
        library.prctl(drop_bound, capability, 0, 0, 0)


def run_bound(*args: str | Path) -> Ended:
    """A command in a process of its own that rights bind."""
    process = start(*args, preexec_fn=_drop_superuser)
    out, err = process.communicate(timeout=120)
    assert "Traceback" not in err
    return Ended(process.returncode, out, err)


@pytest.fixture
def locked(tmp_path):
    """Paths whose rights are given back, so that the folder can be cleared."""
    paths: list[Path] = []
    yield paths
    for path in paths:
        path.chmod(0o700)


@pytest.mark.slow
@linux_only
def test_read_only_recordings_are_fitted_into_another_folder(tmp_path, locked):
    log = write_log(tmp_path / "lab" / "log.csv", stride=8)
    locked += [log, log.parent]
    log.chmod(0o400)
    log.parent.chmod(0o500)
    ended = run_bound("fit", log.parent, "-o", tmp_path / "out", *QUICK)
    assert ended.code in (0, 4), ended.stderr
    assert sorted(path.name for path in log.parent.iterdir()) == ["log.csv"]


@linux_only
def test_a_read_only_output_folder_is_6_on_one_line(tmp_path, locked):
    log = write_log(tmp_path / "lab" / "log.csv", stride=8)
    out = tmp_path / "out"
    out.mkdir()
    locked.append(out)
    out.chmod(0o500)
    ended = run_bound("fit", log, "-o", out, *QUICK)
    assert ended.code == 6
    (line,) = ended.stderr.strip().splitlines()
    assert str(out) in line
    assert os.strerror(13) in line
    assert list(out.iterdir()) == []


@linux_only
def test_a_study_that_may_not_be_changed_is_told_with_the_way_out(tmp_path, locked):
    log = write_log(tmp_path / "lab" / "log.csv")
    before = write_study(log.parent).read_bytes()
    locked.append(log.parent)
    log.parent.chmod(0o500)
    ended = run_bound("study", "exclude", log, "--because", "it slipped")
    assert ended.code == 2
    assert "study.toml: can't be changed" in ended.stderr
    assert "check the rights of its folder" in ended.stderr
    assert (log.parent / "study.toml").read_bytes() == before


@linux_only
def test_what_may_not_be_read_is_named_and_the_rest_goes_on(tmp_path, locked):
    lab = tmp_path / "lab"
    write_log(lab / "good.csv", stride=8)
    secret = write_log(lab / "secret.csv")
    closed = write_log(lab / "closed" / "inside.csv").parent
    listed = write_log(lab / "listed" / "inside.csv").parent
    locked += [secret, closed, listed]
    secret.chmod(0)
    closed.chmod(0)
    listed.chmod(0o400)  # its names may be seen, its files not
    ended = run_bound("fit", lab, "-o", tmp_path / "out", *QUICK)
    assert ended.code == 7
    for path in (secret, closed, listed / "inside.csv"):
        (line,) = (text for text in ended.stderr.splitlines() if str(path) in text)
        assert os.strerror(13) in line
        assert "unreadable_file" in line


def test_a_slow_folder_shows_progress_and_reads_each_file_once(tmp_path, monkeypatch):
    from tissueid.ingest import find_inputs, loading, read_each, read_one
    from tissueid.pipeline import identify

    for k in range(3):
        write_log(tmp_path / f"{k}.csv", stride=8)
    told: list[str] = []
    opened: list[str] = []
    real = os.open

    def slow(path: str, flags: int, *mode: int) -> int:
        # files of compiled kernels are opened as well
        if Path(path).suffix == ".csv":
            opened.append(Path(path).name)
            # while it waits for the file, the user has been told which one is awaited
            assert told[-1].endswith(f"reading recording {len(opened)}")
        return real(path, flags, *mode)

    monkeypatch.setattr(loading.os, "open", slow)
    trials = (item for path in find_inputs([tmp_path]) for item in read_each(path))
    found = identify(
        trials,  # type: ignore[arg-type]
        reload=lambda source: read_one(source.path, source.sheet),
        progress=lambda message, done, total: told.append(message),
    )
    assert opened == ["0.csv", "1.csv", "2.csv"]
    assert len(found.specimens) == 1


#: Lines above the first row of the writer's dialect: two entries, the rate, a blank one, names, units.
HEADER_LINES = 6


def sound_logs(repeats: int) -> list[SyntheticLog]:
    """Holds at two depths of three specimens."""
    logs = (
        Log("hold-8", (Move(8.0, 250.0), Hold(3.0)), repeats=repeats),
        Log("hold-4", (Move(4.0, 100.0), Hold(1.0)), repeats=repeats),
    )
    small = replace(recipe("paper-a-hold-100Hz"), specimens=3, logs=logs)
    return simulate(small, rng=np.random.default_rng(11))


def text_of(log: SyntheticLog) -> str:
    return bluehill_csv(log, dialect=DIALECTS["bare"], decimals=(3, 5, 4)).decode("ascii")


def edited(text: str, line: int, change: tuple[str, str]) -> str:
    """The text with one line changed; lines count from 1."""
    lines = text.split("\r\n")
    assert change[0] in lines[line - 1]
    lines[line - 1] = lines[line - 1].replace(*change, 1)
    return "\r\n".join(lines)


def damaged_files(log: SyntheticLog) -> dict[str, tuple[bytes, int | None, str]]:
    """Name -> bytes, the line that must be named, and a word of the reason."""
    text = text_of(log)
    rows = text.split("\r\n")
    shuffled = "\r\n".join([*rows[:60], rows[90], *rows[60:]])
    return {
        "damaged-mark.csv": (edited(text, 40, (".", ".1.")).encode(), 40, "decimal mark"),
        "damaged-unit.csv": (text.replace("(N)", "(zork)").encode(), HEADER_LINES - 1, "zork"),
        "damaged-order.csv": (shuffled.encode(), 62, "time falls"),
        "damaged-cells.csv": (edited(text, 77, (",", ",7,")).encode(), 77, "4 cells"),
        "damaged-zip.xlsx": (b"PK\x03\x04" + text.encode(), None, "workbook"),
    }


def unidentifiable_files(log: SyntheticLog) -> dict[str, tuple[bytes, str]]:
    """Name -> bytes, and the code or words of the reason: nothing touched, a dead cell, one slow ramp."""
    rng = np.random.default_rng(5)
    air = np.round(rng.normal(0.0, 0.3, log.force_N.size), 4)
    ramp = replace(
        recipe("paper-a-hold-100Hz"), specimen="ramp", rate_Hz=10.0, logs=(Log("ramp", (Move(8.0, 10.0),)),)
    )
    (slow,) = simulate(ramp, rng=rng)
    return {
        "no-contact.csv": (text_of(replace(log, specimen="air", force_N=air)).encode(), "no_contact"),
        "dead-cell.csv": (text_of(replace(log, specimen="dead", force_N=0.0 * air)).encode(), "no_contact"),
        "one-ramp.csv": (text_of(slow).encode(), "not identified"),
    }


def write_lab(folder: Path, *, repeats: int) -> int:
    """Write the folder; returns how many logs are sound."""
    folder.mkdir()
    logs = sound_logs(repeats)
    for log in logs:
        (folder / f"{log.name}.csv").write_text(text_of(log), encoding="ascii", newline="")
    files = {name: one[0] for name, one in (damaged_files(logs[0]) | unidentifiable_files(logs[0])).items()}
    for name, data in files.items():
        (folder / name).write_bytes(data)
    return len(logs)
