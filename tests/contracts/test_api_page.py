"""docs/api.md names what is public, as it is called, and its example runs."""

from __future__ import annotations

import re
from importlib import import_module
from pathlib import Path

import pytest
from reference_pages import RESULTS, api_page

import tissueid
from tissueid.notebook import Shown

REPOSITORY = Path(__file__).resolve().parents[2]
PAGE = (REPOSITORY / "docs" / "api.md").read_text(encoding="utf-8")


def test_the_page_is_that_of_the_program() -> None:
    assert api_page() == PAGE, "run scripts/write-docs"


def test_every_public_name_has_an_entry_and_every_entry_exists() -> None:
    entries = re.findall(r"^### `([\w.]+)`$", PAGE, flags=re.MULTILINE)
    public = {f"tissueid.{name}" for name in tissueid.__all__ if not name.startswith("_")}
    results = {f"{module}.{name}" for module, names in RESULTS.items() for name in names}
    assert set(entries) == public | results
    for entry in entries:
        module, _, name = entry.rpartition(".")
        assert hasattr(import_module(module), name), entry


def test_every_entry_says_what_it_is() -> None:
    for entry in re.split(r"^### ", PAGE, flags=re.MULTILINE)[1:]:
        words = re.sub(r"^```\n.*?^```\n", "", entry, flags=re.MULTILINE | re.DOTALL).splitlines()
        assert any(re.match(r"\w.{5,}", line) for line in words[1:]), words[0]


def test_what_is_said_to_show_itself_does() -> None:
    said = PAGE.partition("show themselves in notebooks")[0].rpartition("first use.")[2]
    names = set(re.findall(r"`(\w+)`", said))
    shown = {
        name
        for module, listed in RESULTS.items()
        for name in listed
        if issubclass(getattr(import_module(module), name), Shown)
    }
    assert names == shown


@pytest.mark.needs_jit
def test_the_example_runs(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(REPOSITORY)
    (block,) = re.findall(r"^```python\n(.*?)^```$", PAGE, flags=re.MULTILINE | re.DOTALL)
    found: dict[str, object] = {}
    exec(compile(block, "api.md", "exec"), found)
    # truth: 63.62 N/mm times 0.021 s; at 100 Hz, and a clock that may be skewed, the time alone is not known
    assert abs(found["fit"].parameter("viscosity_N_s_per_mm").value - 1.336) < 0.2  # type: ignore[attr-defined]
