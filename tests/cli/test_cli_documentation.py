"""The program explains itself; every command of README and docs/ can be typed, and is run or says why not."""

import json
import os
import re
import shlex
import shutil
import subprocess
from dataclasses import dataclass
from pathlib import Path

import click
import numpy as np
import pytest
from command_line import REPOSITORY, python, run, write_csv, write_log, write_study
from identify_stand_ins import of_prior
from reference_pages import api_page, examples_of, flags_page, options_page
from test_cli_laws import WHOLE, recordings

import tissueid
from tissueid import doctor, errors
from tissueid.cli.devices_command import HANDS
from tissueid.cli.export_command import TABLES as FORMS
from tissueid.cli.flags import walk
from tissueid.cli.main import COMMANDS, GROUPS, cli
from tissueid.cli.rupture_command import ASKED as OFFERED
from tissueid.explanations import EXIT_MEANINGS, explain, explanations
from tissueid.flags import FLAGS
from tissueid.haptics.hand import PRESETS
from tissueid.model.kelvin_voigt import kelvin_voigt
from tissueid.quantity_words import QUANTITIES
from tissueid.rendering import first_start
from tissueid.rupture.study import ASKED
from tissueid.store.tidy import TABLES
from tissueid.viewer import bundling

README = (REPOSITORY / "README.md").read_text(encoding="utf-8")
WALKED = list(walk(cli))
EXAMPLES = [(line, name) for name, command in WALKED for line in examples_of(command)]


def words_of(line: str) -> list[str]:
    """The words of an example, without a remark, a redirection or a pipe behind it."""
    typed = re.split(r"\s{2,}|\s[>|]\s", line)[0]
    return shlex.split(typed)


@pytest.fixture
def only_parsed(monkeypatch):
    """Commands are parsed and not run; files of examples need not be there."""
    monkeypatch.setattr(click.Path, "convert", lambda _self, value, _parameter, _context: value)
    monkeypatch.setattr(click.Command, "invoke", lambda _self, _context: 0)


@pytest.mark.parametrize("name", [name for name, _ in WALKED], ids=" ".join)
def test_a_command_has_help_and_examples_of_itself(name):
    ended = run(*name, "--help", code=0)
    head, _, examples = ended.stdout.partition("Examples:")
    lines = [line.strip() for line in examples.strip().splitlines()]
    start = " ".join(("tissueid", *name))
    assert lines
    assert all(line == start or line.startswith(f"{start} ") for line in lines)
    # after the line of usage, at least one sentence
    assert re.search(r"\w[^\n]*\.", head.partition("\n")[2])


#: What can't be typed, so that a check of examples is one.
UNFIT = """\
tissueid fti lab_data/
tissueid fit lab_data/ --drawz 100
tissueid fit lab_data/ --draws ten
tissueid fit lab_data/ --sampler nuts
tissueid study lab_data/
tissueid study exclude lab_data/x.csv extra --because x
tissueid synth paper-a-30
tissueid reproduce everybody""".splitlines()


def test_an_example_can_be_typed_and_what_cannot_is_found(only_parsed):
    for line, _ in EXAMPLES:
        run(*words_of(line)[1:], code=0)
    for line in UNFIT:
        run(*words_of(line)[1:], code=2)


def test_words_that_help_says_without_loading_the_code_are_those_of_the_code():
    assert (PRESETS, ASKED, tuple(TABLES)) == (HANDS, OFFERED, FORMS)


def test_every_option_has_words():
    silent = [
        f"{' '.join(name)} {option.opts[-1]}"
        for name, command in WALKED
        for option in command.params
        if isinstance(option, click.Option) and not option.help
    ]
    assert silent == []


@pytest.mark.parametrize(
    ("page", "made"), [("options", options_page), ("flags", flags_page), ("api", api_page)]
)
def test_a_page_is_that_of_the_program(page, made):
    written = (REPOSITORY / "docs" / f"{page}.md").read_text(encoding="utf-8")
    assert written == made(), "run scripts/write-docs"


HEAVY = ("numpy", "pandas", "lmfit", "rich", "scipy", "numba", "h5py", "plotly", "jinja2", "pint")
LISTING = "import sys, json; print(json.dumps(sorted({name.split('.')[0] for name in sys.modules})))"


def modules_after(code: str) -> set[str]:
    """Top-level modules loaded in a new process after some code."""
    return set(json.loads(python("-c", f"{code}\n{LISTING}").stdout.splitlines()[-1]))


def test_nothing_heavy_is_loaded_before_it_is_used():
    loaded = modules_after("from tissueid.cli.main import main; assert main(['--help']) == 0")
    assert "click" in loaded
    assert loaded.isdisjoint(HEAVY)
    assert modules_after("import tissueid; tissueid.__version__").isdisjoint({*HEAVY, "click"})
    loaded = modules_after("import tissueid; tissueid.read_trials")
    assert "numpy" in loaded
    assert loaded.isdisjoint({"lmfit", "numba", "plotly"})


def test_an_unknown_attribute_is_an_attribute_error():
    with pytest.raises(AttributeError, match="no attribute 'nonsense'"):
        _ = tissueid.nonsense


def test_help_lists_every_command_with_what_it_does_and_every_group_keeps_one_promise():
    text = " ".join(run("--help", code=0, shown="Examples:").stdout.split())
    for name, meaning in COMMANDS.items():
        assert f"{name} {meaning}" in text
    assert len(COMMANDS) == sum(map(len, GROUPS.values()))
    vision = (REPOSITORY / "VISION.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| [123] \| (.*) \|$", vision, flags=re.MULTILINE)
    promised = [name for row in rows for name in re.findall(r"(?<!of )\b[A-Z]\w+", row)]
    assert sorted(promised) == sorted(GROUPS)


def test_version_is_that_of_the_package():
    assert run("--version").stdout == f"tissueid {tissueid.__version__}\n"


MOST_LINES = 25


def test_every_exit_code_is_explained():
    used = {str(code) for code in (errors.EXIT_OK, errors.EXIT_INTERRUPTED, *errors.EXIT_PRECEDENCE)}
    assert set(EXIT_MEANINGS) == used


def test_options_and_files_that_advice_names_exist():
    options = (REPOSITORY / "docs" / "options.md").read_text(encoding="utf-8")
    told = " ".join(f"{one.follows} {one.remedy}" for one in explanations().values())
    for option in set(re.findall(r"--[a-z][a-z-]+", told)):
        assert f"{option}" in options, option
    for command in set(re.findall(r"`tissueid ([a-z-]+)", told)):
        assert f"## `tissueid {command}" in options, command


def test_a_flag_is_explained_with_what_follows_and_what_to_do():
    said = " ".join(run("explain", *FLAGS, code=0).stdout.split())
    for code, advice in FLAGS.items():
        assert {advice.follows[-1], advice.remedy[-1]} == {"."}, code
        own = said.partition(f"flag {code}: ")[2].partition(" flag ")[0]
        assert all(words in own for words in (advice.means, advice.follows, advice.remedy)), code


def test_a_quantity_is_told_with_unit_dependence_and_interval_in_few_lines():
    for name, words in QUANTITIES.items():
        ended = run("explain", words.symbol, code=0)
        said = " ".join(ended.stdout.split())
        assert ended.stdout == run("explain", name).stdout
        for part in (words.symbol, words.unit, words.meaning, words.depends, words.interval):
            assert part in said, name
        assert len(ended.stdout.splitlines()) <= MOST_LINES
    # a name may be typed loosely
    run("explain", "clipped-force", "viscosity_N_s_per_mm_b2", "130", " 7 ", "tau2", "b1,3", code=0)


def test_every_parameter_of_the_model_is_a_quantity():
    printed = {one.name: one.symbol for one in kelvin_voigt(2, 2, 3.0).parameters}
    for name, symbol in printed.items():
        plain = re.sub(r"_b2$", "", name)
        assert explain(symbol).name == explain(name).name == plain


def test_what_is_none_is_answered_with_the_nearest():
    ended = run("explain", "not_identifed", code=2, said="did you mean not_identified")
    assert ended.stdout == ""
    assert "lists what it knows" in run("explain", "xyzzy").stderr


def test_without_a_name_everything_is_listed():
    text = run("explain").stdout
    for name in explanations():
        assert re.search(rf"^\w.*\b{name}\b", text, flags=re.MULTILINE), name
    assert {one["name"] for one in run("explain", "--json").json()} == set(explanations())
    assert run("explain", "7", "-q").stdout == ""


NAMES = [
    "tissueid", "machine", "libraries", "extras", "servo loop", "real time", "devices",
    "viewer page", "browser",
]  # fmt: skip


def test_every_check_is_told_with_what_to_do():
    ended = run("doctor", "--json")
    document = ended.json()
    assert [check["name"] for check in document["checks"]] == NAMES
    assert ended.code == (7 if document["missing"] else 0), ended.stderr
    for check in document["checks"]:
        assert check["state"] in {"ok", "note", "missing"}
        assert check["words"]
    told = run("doctor").stdout
    for check in document["checks"]:
        assert check["name"] in told


def looks() -> dict[str, tuple[str, str]]:
    return {check.name: (check.state, check.way_out) for check in doctor.examine()}


def test_what_is_missing_is_found_and_asking_for_rights_changes_nothing(tmp_path, monkeypatch):
    before = os.sched_getscheduler(0), os.sched_getaffinity(0)
    monkeypatch.setattr(bundling, "BUNDLE", tmp_path)
    monkeypatch.setattr(first_start, "is_compiled", lambda: False)
    required = ["numpy>=1", "no-such-library>=2", "arviz; extra == 'arviz'"]
    monkeypatch.setattr(doctor, "requires", lambda _name: required)
    found = looks()
    assert found["viewer page"][0] == "missing"
    assert found["servo loop"] == ("note", "tissueid doctor --warm")
    assert found["libraries"] == ("missing", "pip install no-such-library")
    assert found["real time"][0] in {"ok", "note"}
    assert (os.sched_getscheduler(0), os.sched_getaffinity(0)) == before
    (tmp_path / "index.html").touch()
    assert looks()["viewer page"][0] == "ok"


@pytest.mark.slow
def test_warming_leaves_nothing_to_compile():
    checks = run("doctor", "--warm", "--json").json()["checks"]
    assert {check["name"]: check["state"] for check in checks}["servo loop"] == "ok"


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
        """The reason for not running it, if it is not run."""
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
    """Take away all that a page's own first commands make; write what its reader is told to write."""
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


def test_every_command_can_be_typed(only_parsed):
    for command in [one for page in pages() for one in commands_of(page)]:
        if command.words[0] == "tissueid" and not re.search(r"\b(FORMAT|PORT)\b", command.text):
            run(*command.words[1:], code=0)


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
