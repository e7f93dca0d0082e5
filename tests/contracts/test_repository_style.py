"""The repository keeps its own rules, and docs/api.md names what is public, as it is called."""

import ast
import re
from functools import cache
from importlib import import_module
from pathlib import Path

import pytest
from reference_pages import RESULTS

import tissueid
from tissueid.documents import plain, typed
from tissueid.flags import Flag
from tissueid.notebook import Shown

REPOSITORY = Path(__file__).resolve().parents[2]
BANNED_NAMES = {"utils", "helpers", "manager", "process", "data2"}
MAX_MODULE_LINES = 600
PAGE = (REPOSITORY / "docs" / "api.md").read_text(encoding="utf-8")


def _python_files() -> list[Path]:
    return sorted((REPOSITORY / "tissueid").rglob("*.py"))


def test_every_module_says_what_it_is_and_is_of_a_readable_length() -> None:
    for path in _python_files():
        text = path.read_text(encoding="utf-8")
        assert text.lstrip().startswith(('"""', 'r"""')), path
        assert text.count("\n") <= MAX_MODULE_LINES, path
        assert path.stem not in BANNED_NAMES, path


def test_docstrings_begin_with_a_verb_or_a_noun() -> None:
    asking = ("What", "Where", "Whether", "Which", "How")
    documented = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)
    for path in _python_files():
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            text = (ast.get_docstring(node) or "") if isinstance(node, documented) else ""
            assert text.split(" ", 1)[0] not in asking, f"{path}: {text.splitlines()[0]}"


def test_pages_that_code_names_are_there() -> None:
    for path in [*_python_files(), *(REPOSITORY / "benchmarks").glob("*.py")]:
        for named in re.findall(r"[\w./-]*[\w-]+\.md\b", path.read_text(encoding="utf-8")):
            places = (REPOSITORY / named, REPOSITORY / "docs" / named, path.parent / named)
            assert any(place.is_file() for place in places), f"{path} names {named}"


def test_modules_that_the_map_names_are_there() -> None:
    text = (REPOSITORY / "ARCHITECTURE.md").read_text(encoding="utf-8")
    named = set(re.findall(r"`([\w/]+/\w+\.py)`", text)) - {"cli/NAME_command.py"}
    assert len(named) > 50
    assert [one for one in sorted(named) if not (REPOSITORY / "tissueid" / one).is_file()] == []


def test_every_public_list_names_what_the_module_has() -> None:
    for path in _python_files():
        if path.name == "__main__.py":
            continue
        parts = path.relative_to(REPOSITORY).with_suffix("").parts
        name = ".".join(parts[:-1] if parts[-1] == "__init__" else parts)
        module = import_module(name)
        for public in getattr(module, "__all__", ()):
            assert hasattr(module, public), f"{name}.{public}"


def test_unknown_flag_is_refused() -> None:
    with pytest.raises(ValueError, match="unknown flag code 'nonsense'"):
        Flag("nonsense", "no such thing")


def test_a_flag_of_a_later_version_is_read_and_flags_are_what_they_say() -> None:
    later = {"code": "of a later version", "message": "m", "size_mm": 2.0}
    assert plain(typed(later, Flag)) == later
    assert Flag("gap", "m", {"gap_s": 2.0}) == Flag.read({"code": "gap", "message": "m", "gap_s": 2.0})
    assert Flag("gap", "m") != Flag("gap", "m", {"gap_s": 2.0})
    assert repr(Flag("gap", "m", {"gap_s": 2.0})) == "Flag('gap', 'm', {'gap_s': 2.0})"


def test_pinned_versions_carry_no_addresses() -> None:
    for path in [REPOSITORY / "constraints.txt", *REPOSITORY.glob("**/*lock*.json")]:
        if ".venv" not in path.parts and "node_modules" not in path.parts:
            assert "://" not in path.read_text(encoding="utf-8"), path


@cache
def _nodes_of(name: str) -> set[str]:
    """Functions, classes and functions of classes of a file of tests, as pytest names them."""
    tree = ast.parse((REPOSITORY / name).read_text(encoding="utf-8"))
    found = {one.name for one in tree.body if isinstance(one, ast.FunctionDef | ast.ClassDef)}
    for one in tree.body:
        if isinstance(one, ast.ClassDef):
            found |= {f"{one.name}::{inner.name}" for inner in one.body if isinstance(inner, ast.FunctionDef)}
    return found


def test_every_line_of_the_system_tests_names_one() -> None:
    lines = (REPOSITORY / "tests" / "system_tests.txt").read_text(encoding="ascii").splitlines()
    assert lines == sorted(set(lines))
    for line in lines:
        name, _, node = line.partition("::")
        assert (REPOSITORY / name).is_file(), line
        assert not node or name not in lines, f"{line}: its file is there already"
        assert not node or node in _nodes_of(name), line


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
def test_the_example_of_the_page_runs(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(REPOSITORY)
    (block,) = re.findall(r"^```python\n(.*?)^```$", PAGE, flags=re.MULTILINE | re.DOTALL)
    found: dict[str, object] = {}
    exec(compile(block, "api.md", "exec"), found)
    # truth: 63.62 N/mm times 0.021 s; at 100 Hz, and a clock that may be skewed, the time alone is not known
    assert abs(found["fit"].parameter("viscosity_N_s_per_mm").value - 1.336) < 0.2  # type: ignore[attr-defined]
