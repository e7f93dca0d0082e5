"""Whatever is handed in, in whatever folder, the answer is one clear message and the right code."""

import ctypes
import json
import os
import subprocess
import sys
import unicodedata
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import pytest
from command_line import QUICK, Ended, log_text, python, read_json, run, start, write_log, write_study

from tissueid.cli.fit_command import print_reasons


def rows_with(change: Callable[[int, str], str]) -> bytes:
    lines = log_text().splitlines()
    return "\n".join(change(number, line) for number, line in enumerate(lines, 1)).encode()


def with_cell(cell: str) -> bytes:
    """The log with another force on line 40."""
    return rows_with(lambda n, line: line.rsplit(",", 1)[0] + cell if n == 40 else line)


#: Files with a bad cell on line 40.
BAD_CELLS: dict[str, bytes] = {
    "nan.csv": with_cell(",NaN"),
    "infinite.csv": with_cell(",1e999"),
    "text.csv": with_cell(",oops"),
    "ragged.csv": with_cell(""),
    "backwards.csv": rows_with(lambda n, line: "0.0" + line[line.index(",") :] if n == 40 else line),
}
BAD_FILES: dict[str, bytes] = BAD_CELLS | {
    "binary.csv": bytes(range(256)) * 40,
    "empty.csv": b"",
    "prose.csv": b"Dear colleague,\nthe data are on the other disk.\n",
    "one-row.csv": b"Time,Extension,Load\n(sec),(mm),(N)\n0.0,0.0,0.0\n",
    "unknown-unit.csv": log_text().replace("(N)", "(zorkmid)").encode(),
    "not-a-workbook.xlsx": b"PK\x03\x04" + bytes(200),
    "no-motion.csv": b"Time,Extension,Load\n(sec),(mm),(N)\n"
    + b"".join(b"%.2f,1.0,2.0\n" % (0.01 * i) for i in range(300)),
    "three-rows.csv": b"Time,Extension,Load\n(sec),(mm),(N)\n0.0,0.0,0.0\n0.1,0.1,0.1\n0.2,0.2,0.3\n",
    "zeros.csv": b"Time,Extension,Load\n(sec),(mm),(N)\n" + b"0.0,0.0,0.0\n" * 50,
    "one-time.csv": b"Time,Extension,Load\n(sec),(mm),(N)\n"
    + b"".join(b"1.0,%.2f,%.2f\n" % (0.01 * i, 0.02 * i) for i in range(50)),
}


def test_sound_files_are_fitted_and_every_bad_one_among_them_is_named_with_its_reason(tmp_path):
    folder = tmp_path / "lab"
    for name, times in (("one", 1.0), ("two", 1.02), ("other", 1.3)):
        write_log(folder / f"{name}.csv", label="other" if name == "other" else "liver", force_times=times)
    bad = {f"bad-{name}": content for name, content in BAD_FILES.items()}
    # a picture in a folder is nothing that was meant
    for name, content in (bad | {"photo.png": b"\x89PNG\r\n\x1a\n" + bytes(500)}).items():
        (folder / name).write_bytes(content)
    ended = run("fit", folder, "-o", tmp_path / "out", *QUICK, code=7)
    document = read_json(tmp_path / "out" / "identification.json")
    assert {one["specimen"]: len(one["trials"]) for one in document["specimens"]} == {"liver": 2, "other": 1}
    refused = {Path(one["path"]).name: one["error"] for one in document["refused"]}
    assert set(refused) == set(bad)
    for name, error in refused.items():
        (said,) = (line for line in ended.stderr.splitlines() if f"/{name}" in line)
        assert said.startswith(f"refused ({error['code']})")
        assert error["message"] in said
        assert any(name in reason for reason in document["exit"]["reasons"])
    assert {refused[f"bad-{name}"]["line"] for name in BAD_CELLS} == {40}
    # what can be read but not fitted is described by inspect
    told = {
        Path(one["path"]).name: one.get("error") for one in run("inspect", folder, "--json", code=7).json()
    }
    assert {told[f"bad-{name}"]["line"] for name in BAD_CELLS} == {40}
    assert told["bad-no-motion.csv"] is None


@pytest.mark.parametrize(
    ("args", "codes"),
    [
        (["--columns", "force=Druck"], {3}),
        (["--columns", "force=#9"], {3}),
        (["--columns", "time=Load,force=Time"], {3}),
        (["--units", "time=mm"], {2}),
        (["--contact", "500"], {3}),
        pytest.param(["--contact", "-500"], {0, 3, 4}, marks=pytest.mark.slow),
        (["--contact", "1e300"], {2}),
        (["--contact", "-1e300"], {2}),
        (["--contact", "-9999"], {0, 3, 4}),
        (["--compression", "negative"], {0, 3, 4}),
        (["--recipe", "testxpert-workbook"], {3}),
        (["--specimen-by", "zzz"], {2}),
    ],
)
def test_a_doubtful_option_ends_cleanly(tmp_path, args, codes):
    log = write_log(tmp_path / "log.csv")
    ended = run("fit", log, *args, "-o", tmp_path / "out", *QUICK, code=codes)
    assert ended.stderr.strip() or ended.code == 0


def test_an_output_folder_that_is_a_file_or_below_one_is_refused(tmp_path):
    log = write_log(tmp_path / "log.csv")
    for args in (["fit", log, *QUICK], ["synth", "paper-a-hold-100Hz"]):
        run(*args, "-o", log, code=2, said="is a file")
        run(*args, "-o", log / "out", code=2)
    assert log.read_text(encoding="ascii") == log_text()


def test_results_can_only_be_written_where_there_is_a_folder(fitted_log, tmp_path):
    out, log = fitted_log / "out", fitted_log / "lab" / "log.csv"
    for command in (("export", out, "-o"), ("report", out, "-o"), ("inspect", log, "--html")):
        run(*command, tmp_path / "none" / "file", code=2, said="can't be written")


@pytest.mark.parametrize("content", ["", "{", "[]", "null", '{"schema": "tissueid/identification/1"}'])
def test_a_spoilt_set_is_refused_by_every_command(fitted_log, content):
    out = fitted_log / "out"
    for path in (out / "identification.json", *out.glob(".runs/*/identification.json")):
        path.write_text(content, encoding="utf-8")
    for command in ("validate", "report", "export"):
        assert run(command, out).code == 6, command


def test_a_second_fit_repairs_a_spoilt_set(fitted_log):
    out, log = fitted_log / "out", fitted_log / "lab" / "log.csv"
    (out / "bundle.h5").write_bytes(b"spoilt")
    assert run("validate", out).code == 6
    run("fit", log, "-o", out, *QUICK)
    assert run("validate", out).code == 0


def test_a_file_named_twice_is_read_once(tmp_path):
    log = write_log(tmp_path / "lab" / "log.csv")
    assert len(run("inspect", log, tmp_path / "lab", log, "--json").json()) == 1


def test_a_file_that_changes_between_the_passes_is_refused(tmp_path, monkeypatch):
    from tissueid import collection, pipeline

    monkeypatch.setattr(collection, "CACHE_BYTES", 0)
    first = write_log(tmp_path / "a.csv")
    write_log(tmp_path / "b.csv", force_times=1.1)
    real = pipeline.fit_with_state

    def changing(*args: object, **options: object) -> object:
        write_log(first, force_times=2.0)
        return real(*args, **options)  # type: ignore[arg-type]

    monkeypatch.setattr(pipeline, "fit_with_state", changing)
    said = ("a.csv", "changed while it was being fitted")
    run("fit", first, tmp_path / "b.csv", "-o", tmp_path / "out", *QUICK, code=3, said=said)


@pytest.mark.parametrize("args", [["--help"], ["inspect", "LOG"], ["inspect", "LOG", "--json"]])
def test_a_closed_pipe_is_no_error(tmp_path, args):
    log = write_log(tmp_path / "log.csv")
    process = start(*[str(log) if arg == "LOG" else arg for arg in args])
    # closed before a byte is written, as by a reader that has seen enough
    process.stdout.close()
    with process.stderr as stream:
        said = stream.read()
    assert (process.wait(timeout=60), said) == (0, "")


linux_only = pytest.mark.skipif(sys.platform != "linux", reason="rights and names of a POSIX system")


def test_many_specimens_that_are_not_identified_are_all_named(capfd):
    reasons = tuple(f"cow {k}: not identified: viscosity_Ns_per_mm" for k in range(40))
    reasons += ("goat: not identified: static_N_per_mm", "cow 7: Levenberg-Marquardt did not converge")
    ended = SimpleNamespace(refused=(), exit=SimpleNamespace(reasons=reasons))
    print_reasons(ended, quiet=0)  # type: ignore[arg-type]
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
