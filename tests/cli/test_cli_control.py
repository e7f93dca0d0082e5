"""``tissueid control``: loops of the adaptive controller, their document, page and refusals."""

from __future__ import annotations

import re
from typing import Any

import pytest
from command_line import run
from rendered_tissues import PAPER_A, bundle_of

from tissueid.store.bundle import write_bundle

pytestmark = pytest.mark.needs_jit


PRESET = ("control", "--preset", "paper-a")


def numbers(document: Any) -> dict[str, tuple[Any, str]]:
    return {row["name"]: (row["value"], row["kind"]) for row in document["numbers"]}


def test_a_bundle_runs_beside_the_frozen_controller_and_its_own_stiffness(tmp_path):
    path = tmp_path / "bundle.h5"
    write_bundle(bundle_of(PAPER_A), path)
    given = "--stiffness-scale 100 --json --seconds 4"
    document = run("control", path, *given.split(), code=0).json("control")
    assert [one["name"] for one in document["runs"]] == ["adaptive", "frozen", "unscaled"]
    assert [one["stiffness_scale"] for one in document["runs"]] == [100.0, 100.0, 1.0]
    assert document["runs"][0]["measures"]["error_rms_mm"] < 0.01
    for estimate in document["runs"][1]["estimates"]:
        assert estimate["start"] == estimate["end"]
    table = numbers(document)
    assert table["operator mass"] == (1.25, "reading")
    assert table["device damping"] == (115.4, "reading")
    assert table["virtual mass"] == (2.0, "assumed")
    assert table["saturation"] == (None, "assumed")


def test_what_the_user_states_is_called_stated():
    stated = "--operator 2 5 100 --virtual-mass 3 --gamma 1 2 3 --saturation 50 --frozen --start zero"
    document = run(*PRESET, "--json", "--seconds", "2", *stated.split()).json()
    table = numbers(document)
    assert table["operator damping"] == (5.0, "stated")
    assert table["device mass"] == (1.158, "reading")
    assert table["virtual mass"] == (3.0, "stated")
    assert table["Gamma of stiffness"] == (3.0, "stated")
    assert table["saturation"] == (50.0, "stated")
    assert [one["name"] for one in document["runs"]] == ["frozen", "adaptive"]
    assert [one["start"] for one in document["runs"][0]["estimates"]] == [0.0, 0.0, 0.0]


def test_a_loop_that_diverges_is_said_and_ends_with_4():
    given = "--variant A --stiffness-scale 100 --task impacts --seconds 20 --noise 0.05 --seed 3"
    kept = run(*PRESET, *given.split(), code=0)
    lost = run(*PRESET, *given.split(), "--no-projection", code=4)
    assert "DIVERGED" not in kept.stdout.splitlines()[3]
    assert re.search(r"^adaptive .*; DIVERGED at \d+\.\d+ s$", lost.stdout, re.MULTILINE)


def test_a_device_with_a_force_sensor_is_rendered_on_and_another_refused():
    ended = run(*PRESET, "--device", "sim", "--seconds", "2", code=0, shown="shaped by the guard")
    assert re.search(r"^on sim    error 0\.[12]\d\d mm rms", ended.stdout, re.MULTILINE)
    run(*PRESET, "--device", "falcon", code=5, said="falcon has no force sensor")


def test_too_little_margin_and_a_tissue_left_behind_are_said():
    said = ("less than 1.5 times it", "deeper than the 8 mm that were identified")
    run(*PRESET, "--virtual-mass", "0.5", "--stiffness-scale", "0.02", shown=said)


def test_the_document_is_json_whatever_happens():
    given = "--environment impedance --stiffness-scale 100 --seconds 2 --json --device sim"
    ended = run(*PRESET, *given.split())
    document = ended.json("control")
    assert document["device"]["error_rms_mm"] < 0.3
    assert ended.code == (0 if document["runs"][0]["measures"]["diverged_s"] is None else 4)
