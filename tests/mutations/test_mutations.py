"""Each fault of :mod:`mutants` is seen by the tests that it names."""

import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from mutants import COMPILED, INTERPRETED, Mutant

REPOSITORY = Path(__file__).resolve().parents[2]
#: pytest: some tests failed; a fault that can't be imported is none.
FAILED = 1
#: What takes longer waits for ever: without a fault it is seconds [s].
LONGEST_S = 120


@pytest.fixture(scope="module")
def copied(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A folder with a package of its own, as it is here."""
    place = tmp_path_factory.mktemp("mutated")
    ignored = shutil.ignore_patterns("kernels-*", "node_modules", "web")
    shutil.copytree(REPOSITORY / "tissueid", place / "tissueid", ignore=ignored)
    (place / "schemas").symlink_to(REPOSITORY / "schemas")
    yield place
    shutil.rmtree(place)


def ending(place: Path, mutant: Mutant, *, compiled: bool) -> subprocess.CompletedProcess[str]:
    """Run the tests with one fault in the package."""
    file = place / "tissueid" / mutant.file
    whole = file.read_text(encoding="utf-8")
    environment = os.environ | {"PYTHONPATH": str(place), "NUMBA_CACHE_DIR": str(place / "kernels")}
    environment |= {} if compiled else {"NUMBA_DISABLE_JIT": "1"}
    options = ["-q", "-x", "-p", "no:cacheprovider", "-p", "no:xdist", "-m"]
    # a test that is named by itself is run, however it is marked
    whole_files = not compiled and "::" not in mutant.tests[0]
    marked = "not slow and not needs_jit" if whole_files else "not slow"
    file.write_text(whole.replace(mutant.old, mutant.new), encoding="utf-8")
    try:
        return subprocess.run(
            [sys.executable, "-P", "-m", "pytest", *options, marked, *mutant.tests],
            cwd=REPOSITORY, env=environment, capture_output=True, text=True, timeout=LONGEST_S, check=False,
        )  # fmt: skip
    except subprocess.TimeoutExpired as late:
        # a test that waits for what does not come any more has seen it
        return subprocess.CompletedProcess(late.cmd, FAILED, str(late.stdout), str(late.stderr))
    finally:
        file.write_text(whole, encoding="utf-8")


@pytest.mark.parametrize("mutant", INTERPRETED, ids=lambda one: one.name)
def test_a_fault_is_caught(copied: Path, mutant: Mutant) -> None:
    done = ending(copied, mutant, compiled=False)
    assert done.returncode == FAILED, done.stdout[-2000:] + done.stderr


@pytest.mark.parametrize("mutant", COMPILED, ids=lambda one: one.name)
def test_a_fault_of_the_compiled_loop_is_caught(copied: Path, mutant: Mutant) -> None:
    done = ending(copied, mutant, compiled=True)
    assert done.returncode == FAILED, done.stdout[-2000:] + done.stderr


@pytest.mark.parametrize("by_name", [False, True])
def test_without_a_fault_the_same_tests_pass(copied: Path, by_name: bool) -> None:
    names = sorted({name for one in INTERPRETED for name in one.tests if ("::" in name) == by_name})
    plain = Mutant("none", "haptics/guard.py", '"""The guard:', '"""The guard:', tuple(names))
    done = ending(copied, plain, compiled=False)
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr


def test_there_are_forty_of_them_each_with_its_name_and_its_place() -> None:
    faults = (*INTERPRETED, *COMPILED)
    assert len(faults) == len({one.name for one in faults}) >= 40
    for one in faults:
        text = (REPOSITORY / "tissueid" / one.file).read_text(encoding="utf-8")
        assert text.count(one.old) == 1, f"{one.file} has not once {one.old!r}"
