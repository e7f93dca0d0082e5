"""Fixtures shared by all tests."""

import os
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

# as the command does: threads of the linear algebra library make small matrices ten times slower
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
# settings of whoever runs the tests are no part of them
os.environ["TISSUEID_CONFIG"] = ""

REPOSITORY = Path(__file__).resolve().parent.parent


def pytest_addoption(parser: pytest.Parser) -> None:
    """Options of the tests that need a real device; see docs/hardware-checklist.md."""
    group = parser.getgroup("falcon", "a real Novint Falcon (docs/hardware-checklist.md)")
    group.addoption("--falcon", action="store_true", help="run the tests that move a real Falcon")
    group.addoption("--falcon-port", metavar="PATH", help="serial port or pseudo-terminal instead of USB")
    group.addoption("--falcon-firmware", metavar="FILE", help="firmware, where the device has none running")
    group.addoption(
        "--falcon-report",
        metavar="FILE",
        default="hardware-report.json",
        help="where the readings are written",
    )


#: Files that take longest: begun first, so that no worker is left alone with one at the end.
LONGEST = (
    "test_mutations", "test_population_sampler", "test_cli_bad_input", "test_cli_documentation",
    "test_study_batch", "test_study_fit", "test_cli_fit", "test_cli_interrupts", "test_cli_real",
    "test_design_precision", "test_design_search", "test_ingest_hostile", "test_render_sessions",
    "test_pipeline_statistics", "test_inference_unloading", "test_render_servo_process",
    "test_render_faults",
)  # fmt: skip


#: What belongs to the system tier by its measured time: a file, or one of its classes or functions, a line.
SYSTEM = frozenset((REPOSITORY / "tests" / "system_tests.txt").read_text(encoding="ascii").split())


def prefixes(node: str) -> list[str]:
    """A test's file, class and function, each as the node id that names all that is in it."""
    parts = node.partition("[")[0].split("::")
    return ["::".join(parts[: number + 1]) for number in range(len(parts))]


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark the tests of the system tier; longest files first, the others as they stand."""
    for item in items:
        if not SYSTEM.isdisjoint(prefixes(item.nodeid)):
            item.add_marker(pytest.mark.system)
    place = {name: number for number, name in enumerate(LONGEST)}
    items.sort(key=lambda item: place.get(item.path.stem, len(LONGEST)))


#: Folders and files whose system tests compute for long what tests of other files run too.
UNTRACED = {"bench", "contrast", "design", "inference", "ingest", "library", "measured", "model", "pipeline"}
UNTRACED |= {"population", "reproduce", "rupture", "segment", "selfcheck", "study", "synth"}
UNTRACED |= {"test_cli_laws", "test_cli_populations", "test_cli_real", "test_report_page"}


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: pytest.Item) -> Iterator[None]:
    """Take the tracer, which makes arithmetic half as long again, from tests that add no line to coverage."""
    tracer = sys.gettrace()
    if item.get_closest_marker("system") and not UNTRACED.isdisjoint((item.path.parent.name, item.path.stem)):
        sys.settrace(None)
    try:
        return (yield)
    finally:
        sys.settrace(tracer)


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Folder with openly licensed real recordings, which are not part of this repository."""
    named = os.environ.get("TISSUEID_SHARED_DATA")
    folder = Path(named) if named else REPOSITORY.parent / "shared" / "data"
    if not folder.is_dir():
        pytest.skip(f"no real recordings at {folder}; set TISSUEID_SHARED_DATA to a folder that has them")
    return folder


@pytest.fixture(scope="session")
def datasets() -> Path:
    """Folder of the synthetic sets that the repository carries."""
    return REPOSITORY / "datasets_synthetic"
