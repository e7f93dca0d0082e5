"""``tissueid export`` of single tissues and for MATLAB."""

from __future__ import annotations

from pathlib import Path

import pytest
from command_line import run
from fit_factory import identification, specimen_fit
from rendered_tissues import PAPER_A, bundle_of
from scipy.io import loadmat

from tissueid.store.bundle import write_bundle
from tissueid.store.outputs import OutputSet
from tissueid.store.results import write_results


@pytest.fixture
def bundle(tmp_path: Path) -> Path:
    path = tmp_path / "bundle.h5"
    write_bundle(bundle_of(PAPER_A), path)
    return path


@pytest.mark.parametrize(
    ("form", "said"),
    [("c-header", "paper_a_step("), ("febio", '<material id="1"'), ("abaqus", "*VISCOELASTIC, TIME=PRONY")],
)
def test_a_bundle_is_written_for_another_program(bundle: Path, form: str, said: str) -> None:
    ended = run("export", bundle, "--format", form)
    assert ended.code == 0, ended.stderr
    assert said in ended.stdout


def test_a_matlab_file_is_written_where_it_is_asked_for(bundle: Path, tmp_path: Path) -> None:
    target = tmp_path / "tissues.mat"
    assert run("export", bundle, "--format", "mat", "-o", target).code == 0
    assert str(loadmat(str(target), squeeze_me=True)["tissueid"]["specimen"]) == "paper-a"


@pytest.mark.parametrize(
    ("args", "said"),
    [
        (("--format", "mat"), "-o tissues.mat"),
        (("--format", "abaqus", "--depth", "40"), "outside what is claimed"),
        (("--format", "abaqus", "--depth", "nan"), "outside what is claimed"),
    ],
)
def test_what_cannot_be_written_is_refused(bundle: Path, args: tuple[str, ...], said: str) -> None:
    ended = run("export", bundle, *args)
    assert ended.code == 2
    assert said in ended.stderr


def test_of_several_specimens_one_is_chosen(tmp_path: Path) -> None:
    out = tmp_path / "out"
    with OutputSet(out) as outputs:
        write_results(outputs, identification([specimen_fit("kidney 3"), specimen_fit("spleen 1")]))
        outputs.commit()
    several = run("export", out, "--format", "c-header")
    assert several.code == 2
    assert "--specimen" in several.stderr
    wrong = run("export", out, "--format", "c-header", "--specimen", "nobody")
    assert wrong.code == 2
    assert "nobody" in wrong.stderr
    assert "kidney_3_step(" in run("export", out, "--format", "c-header", "--specimen", "kidney 3").stdout
