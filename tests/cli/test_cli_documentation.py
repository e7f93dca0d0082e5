"""Every command of README and docs/ can be typed; each is run, or says why not; links lead somewhere."""

from __future__ import annotations

import re
import shlex
import shutil
import subprocess
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from command_line import REPOSITORY, run, write_csv, write_log, write_study
from identify_stand_ins import of_prior
from test_cli_examples import README, any_path, unfit
from test_cli_impact import WHOLE, recordings

#: Written from the program, whose examples are tested as such.
GENERATED = {"options.md", "flags.md", "api.md"}
PROGRAMS = ("tissueid", "mkdir", "cp", "pip", "pytest", "python", "dask", "scripts/demo", "scripts/test")

#: Why a command is not run -> what it is known by.  The reasons stand in docs/index.md.
NOT_RUN = {
    "it needs a device": r"falcon(?! --json)|devices (home|test|calibrate)",
    "it goes on until it is ended": r"--viewer|--serve|--watch|--bell|devices emulate|^tissueid view"
    r"|^tissueid render$|^tissueid watch (?!.*--once)|^tissueid render rupture/|falcon\.emulator"
    r"|population\.h5 --draw",
    "it needs a network, a cluster or another machine": r"://|192\.0\.2\.|^dask|^pip install '",
    "it installs or tests the program": r"^pip install \.|^scripts/|^pytest",
    "it takes minutes; a shorter one is run": r"^tissueid reproduce all|--simulations 500|^python benchmarks/"
    r"|lab_data/ -o rupture --criterion auto",
    "its recordings come from a machine, and tests of the readers have such": (
        r"meat\.xlsx|cartilage\.txt|fibre\.csv|odd\.csv|session 3"
    ),
    "capital letters stand for names of yours": r"\b(OUT|FORMAT|PATHS|HOST)\b",
}


@dataclass(frozen=True)
class Command:
    """One line of a page."""

    page: str
    line: int
    text: str

    @property
    def words(self) -> list[str]:
        """As a shell would part it, without a remark behind it."""
        return shlex.split(
            re.split(r"\s{2,}(?=\S)(?![^\"]*\"(?:[^\"]*\"[^\"]*\")*[^\"]*$)", self.text)[0], comments=True
        )

    @property
    def not_run(self) -> str | None:
        """Why it is not run, if it is not."""
        plain = " ".join(self.words)
        return next((why for why, pattern in NOT_RUN.items() if re.search(pattern, plain)), None)


def pages() -> list[Path]:
    """README and every page that somebody wrote."""
    docs = sorted((REPOSITORY / "docs").glob("*.md"))
    return [REPOSITORY / "README.md", *(page for page in docs if page.name not in GENERATED)]


def commands_of(page: Path) -> list[Command]:
    """Lines of blocks without a language, or indented ones, that begin with a program."""
    found = []
    fence: str | None = None
    for number, line in enumerate(page.read_text(encoding="utf-8").splitlines(), 1):
        if line.startswith("```"):
            fence = line[3:] if fence is None else None
            continue
        block = fence in {"", "sh", "bash"} or (fence is None and line.startswith("    "))
        text = line.strip()
        if block and text.split(" ")[0] in PROGRAMS:
            found.append(Command(page.name, number, text))
    return found


#: What a fit of the documentation is given here, so that it takes a second: the way is tested, no number.
SETTINGS = """\
[fit]
branches = "1"
stiffness-degree = "0"
draws = 400
population = "no"
[calibrate]
simulations = 20
[rupture]
criterion = "work"
"""
#: Exit codes beside 0: something is not identified, or is missing in a study that has just been begun.
ENDS = {"tissueid study check": {0, 7}, "tissueid calibrate": {0, 4, 7}}
USUAL = {0, 4}
#: Run by tests of their own, with the files and the output that they print.
ELSEWHERE = {"README.md", "design.md"}
PAGES = [page for page in pages() if commands_of(page) and page.name not in ELSEWHERE]
STUDY = """schema = "tissueid/study/1"
[study]
title = "kidney and liver"
licence = "CC-BY-4.0"
"""


@pytest.fixture(scope="module")
def prepared(tmp_path_factory):
    """A folder with what the pages name, made once."""
    folder = tmp_path_factory.mktemp("docs")
    (folder / "tissueid.toml").write_text(SETTINGS, encoding="utf-8")
    lab = folder / "lab_data"
    write_log(lab / "Specimen_RawData_1.csv", label="kidney")
    write_log(lab / "run_7.csv", label="liver", force_times=1.5)
    (lab / "study.toml").write_text(STUDY, encoding="utf-8")
    several = STUDY
    for number, times in enumerate((0.8, 0.9, 1.0, 1.1, 1.25), 1):
        write_log(folder / f"head-{number}.csv", label=None, force_times=times)
        several += f'[[specimen]]\nname = "head {number}"\nage_years = {50 + number**2}\n'
        several += f'sex = "{"fm"[number % 2]}"\n'
        several += f'[[trial]]\nfile = "head-{number}.csv"\nspecimen = "head {number}"\n'
    (folder / "study.toml").write_text(several, encoding="utf-8")
    for name, times in (("slow.csv", 1.0), ("fast.csv", 1.1), ("hold-8-1.csv", 1.0)):
        write_log(folder / name, label=None, force_times=times)
    force = np.linspace(0.0, 200.0, 400)
    for name in ("rigid-1.csv", "rigid-2.csv", "lab-a/steel/steel-1.csv", "lab-a/steel/steel-2.csv"):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        write_csv(folder / name, np.linspace(0.0, 4.0, 400), force / 1000.0, force)
    (folder / "rig").mkdir()
    recordings(folder / "rig", WHOLE)
    for own, phantoms in (("a", (1, 3, 5)), ("b", (2, 4, 6))):
        for number in phantoms:
            write_log(
                folder / f"lab-{own}" / f"phantom-0{number}" / "hold.csv",
                label=None,
                force_times=1 + 0.01 * number,
            )
    shutil.copytree(
        REPOSITORY / "datasets_synthetic" / "paper-a-hold-100Hz",
        folder / "datasets_synthetic" / "paper-a-hold-100Hz",
    )
    return folder


@pytest.fixture(scope="module")
def fitted(prepared):
    """The same with a finished fit: what pages take for granted."""
    with pytest.MonkeyPatch.context() as patched:
        patched.chdir(prepared)
        run("fit", "lab_data", "-o", "out", "-q", code=USUAL)
        for name in "ab":
            places = sorted(Path().glob(f"lab-{name}/phantom-*"))
            run("fit", *places, "-o", f"fit-{name}", "-q", "--specimen-by", "(phantom-[0-9]+)", code=USUAL)
    for name in ("before", "after"):
        shutil.copytree(prepared / "out", prepared / name, symlinks=True)
    shutil.copy(prepared / "out" / "bundle-kidney.h5", prepared / "bundle.h5")
    shutil.copy(prepared / "bundle.h5", prepared / "out" / "bundle.h5")
    return prepared


@pytest.fixture
def place(fitted, tmp_path, monkeypatch):
    shutil.copytree(fitted, tmp_path / "here", symlinks=True)
    monkeypatch.chdir(tmp_path / "here")
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    monkeypatch.setattr("tissueid.selfcheck.tissue.identify", of_prior)
    return tmp_path / "here"


def made_ready(page: str, place: Path) -> None:
    """What a page's own first commands make is not there yet; what its reader is told to write is."""
    if page in {"study.md", "tutorial.md"}:
        (place / "lab_data" / "study.toml").unlink()
        shutil.rmtree(place / "out")
    if page == "calibrate.md":
        # a study of one specimen
        (place / "lab_data" / "run_7.csv").unlink()
    if page == "tutorial.md":
        shutil.rmtree(place / "lab_data")
    if page == "rupture.md":
        for path in (REPOSITORY / "datasets_synthetic" / "rupture-18").glob("rupture-0[12]-*.csv"):
            shutil.copy(path, place / "lab_data")
        write_study(place, "[[trial]]", 'file = "lab_data/rupture-*.csv"')


def typed(command: Command) -> None:
    """Run one command as its line says."""
    words = [
        match
        for word in command.words
        for match in (sorted(map(str, Path().glob(word))) if "*" in word and " " not in word else [word])
    ]
    if words[0] != "tissueid":
        subprocess.run(words, check=True)
        return
    allowed = next((codes for start, codes in ENDS.items() if command.text.startswith(start)), USUAL)
    run(*words[1:], code=allowed)
    if command.text.startswith("tissueid study init"):
        study = Path(words[3]) / "study.toml"
        text = study.read_text(encoding="utf-8")
        study.write_text(re.sub(r"(?m)^#? ?licence = .*$", 'licence = "CC-BY-4.0"', text), encoding="utf-8")


@pytest.mark.slow
@pytest.mark.needs_jit
@pytest.mark.parametrize("page", [page.name for page in PAGES])
def test_commands_of_a_page_run(page, place):
    made_ready(page, place)
    for command in commands_of(REPOSITORY / "docs" / page):
        if command.not_run is None:
            typed(command)


def test_every_command_can_be_typed(monkeypatch):
    any_path(monkeypatch)
    for command in [one for page in pages() for one in commands_of(page)]:
        if command.words[0] == "tissueid" and not re.search(r"\b(FORMAT|PORT)\b", command.text):
            assert unfit(shlex.join(command.words)) is None, command


def test_the_index_names_every_page_and_what_is_not_run_with_its_reason():
    index = (REPOSITORY / "docs" / "index.md").read_text(encoding="utf-8")
    used = {one.not_run for page in pages() for one in commands_of(page)} - {None}
    assert used == set(NOT_RUN)
    for why in NOT_RUN:
        assert f"* {why}" in index, why
    for page in (REPOSITORY / "docs").glob("*.md"):
        assert page.name == "index.md" or f"]({page.name})" in index.replace("\n  ", " "), page.name


def test_every_link_leads_somewhere():
    for page in [*pages(), *(REPOSITORY / "docs" / name for name in sorted(GENERATED))]:
        for link in re.findall(r"\]\(([^)\s]+)\)", page.read_text(encoding="utf-8")):
            if "://" not in link and not link.startswith("#"):
                assert (page.parent / link.partition("#")[0]).exists(), (page.name, link)


def test_the_table_of_slow_runs_agrees_with_the_files():
    page = (REPOSITORY / "reports" / "slow" / "README.md").read_text(encoding="utf-8")
    listed = dict(
        re.findall(r"^\| ([\w-]+\.txt) \|.*\| (\d|not run to its end) \|$", page, flags=re.MULTILINE)
    )
    slow = REPOSITORY / "reports" / "slow"
    assert set(listed) == {path.name for path in slow.glob("*.txt")}
    for name, said in listed.items():
        (ended,) = re.findall(
            r"^exit: (\d|the test itself was not run to its end)",
            (slow / name).read_text(encoding="utf-8"),
            flags=re.MULTILINE,
        )[:1]
        assert said == ended.replace("the test itself was ", ""), name


@pytest.mark.parametrize(("name", "count"), [("coverage", 6), ("coverage-total", 1), ("coverage-frames", 2)])
def test_coverages_of_the_page_are_those_of_the_files(name, count):
    page = (REPOSITORY / "docs" / "calibrate.md").read_text(encoding="utf-8")
    text = (REPOSITORY / "reports" / "slow" / f"{name}.txt").read_text(encoding="utf-8")
    cases = re.findall(r"^(\S.*): \d+ specimens.*\n.*\n((?:\S.*\n)+?)(?:\.|F)$", text, flags=re.MULTILINE)
    assert len(cases) == count
    # nuisances of a frame alone are no part of what is claimed
    claimed = r"(?!frame_)(\S*_N|.*relaxation)" if name == "coverage-frames" else ""
    for case, rows in cases:
        of_tissue = [row for row in rows.splitlines() if re.match(claimed, row)]
        shares = [float(re.findall(r"(?<= )\d+\.\d(?= )", row)[3]) for row in of_tissue]
        assert f"| {case} | {min(shares)} to {max(shares)} % |" in page, case


@pytest.fixture
def reader_folder(tmp_path, datasets, monkeypatch):
    """An empty folder with a few recordings where README says they are."""
    for target in ("lab_data", "datasets_synthetic/paper-a-hold-100Hz"):
        (tmp_path / target).mkdir(parents=True)
        source = datasets / "paper-a-hold-100Hz" / "hold-8-1.csv"
        (tmp_path / target / source.name).write_bytes(source.read_bytes())
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_readme_runs_as_printed(reader_folder):
    commands = [one.words[1:] for one in commands_of(REPOSITORY / "README.md") if one.words[0] == "tissueid"]
    named = "lab_data/ inspect inspect study fit models validate report export watch synth render"
    assert [words[0] for words in commands] == named.split()
    for words in commands:
        run(*words, code=0)
    table = re.findall(r"^\| `([^`]+)` \|", README, flags=re.MULTILINE)
    for name in table:
        assert list((reader_folder / "out").glob(name.replace("<specimen>", "*"))), name
    found: dict[str, object] = {}
    for block in re.findall(r"^```python\n(.*?)^```$", README, flags=re.MULTILINE | re.DOTALL):
        exec(compile(block, "README.md", "exec"), found)
    viscosity = found["sampled"]["eta"]  # type: ignore[index]
    # truth: 63.62 N/mm times 0.021 s
    low, high = viscosity.interval(0.95)
    assert low <= 63.62 * 0.021 <= high
    assert found["own"].result.model.name == "power * constant * creep"  # type: ignore[attr-defined]


def test_readme_names_every_exit_code_a_command_can_end_with():
    (text,) = re.findall(r"^Exit codes: (.*?)\n\n", README, flags=re.MULTILINE | re.DOTALL)
    assert {int(code) for code in re.findall(r"\b(\d+) ", text)} == {0, 1, 2, 3, 4, 5, 6, 7, 130}
