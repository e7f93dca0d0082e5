"""Commands that the documentation prints, where they stand, and which of them no test runs."""

from __future__ import annotations

import re
import shlex
from dataclasses import dataclass
from pathlib import Path

REPOSITORY = Path(__file__).resolve().parents[2]
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
