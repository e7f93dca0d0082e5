"""Options of the quoted numbers, as typed."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from command_line import QUICK, run, write_log


@pytest.mark.parametrize(
    ("args", "said"),
    [
        (["--frequencies", "0.1;1"], "--frequencies"),
        (["--frequencies", "0,1"], "--frequencies"),
        (["--depths", "deep"], "--depths"),
        (["--tip", "sphere"], "sphere:3"),
        (["--tip", "pyramid:3"], "not offered"),
        (["--tip", "cone:95"], "half angle"),
        (["--thickness", "5"], "--tip"),
        (["--tip", "flat:2", "--thickness", "-5"], "thickness"),
        (["--tip", "flat:2", "--poisson", "0.6"], "0.6"),
    ],
)
def test_what_cannot_be_understood_is_wrong_usage(tmp_path: Path, args: list[str], said: str) -> None:
    ended = run("fit", write_log(tmp_path / "log.csv"), "-o", tmp_path / "out", *args)
    assert ended.code == 2
    assert said in ended.stderr
    assert not (tmp_path / "out").exists()


def test_numbers_that_are_asked_for_are_in_the_document_and_in_few_lines(tmp_path: Path) -> None:
    log = write_log(tmp_path / "log.csv", stride=1)
    out = tmp_path / "out"
    ended = run(
        "fit", log, "-o", out, *QUICK, "--tip", "sphere:4", "--thickness", "30", "--poisson", "0.45",
        "--frequencies", "1,500", "--unloading",
    )  # fmt: skip
    assert ended.code in (0, 4)
    lines = [line for line in ended.stdout.splitlines() if line.startswith(("  measured", "  modulus"))]
    assert [line.split()[0] for line in lines] == ["modulus", "measured,"]
    specimen = json.loads((out / "identification.json").read_text())["specimens"][0]
    asked = {
        entry["at"]["frequency_Hz"]: entry
        for entry in specimen["quoted"]["model"]
        if entry["name"] == "tan_delta"
    }
    assert set(asked) == {1.0, 500.0}
    assert asked[500.0]["value"] is None
    assert "outside" in asked[500.0]["reason"]
    assert specimen["quoted"]["assumptions"]["poisson"] == 0.45
    # the contact is where the load channel's lag puts it: a sample more or less
    assert specimen["unloading"]["samples_in_air"] <= 1
