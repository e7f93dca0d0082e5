"""``docs/options.md``, ``api.md`` and ``flags.md``, written from the command line, signatures and tables."""

from __future__ import annotations

import inspect
import re
from collections.abc import Iterator
from dataclasses import is_dataclass
from importlib import import_module
from typing import Any

import click

import tissueid
from tissueid.cli.config_command import TYPED_ONLY, option_name
from tissueid.cli.flags import walk
from tissueid.cli.main import cli
from tissueid.explanations import EXIT_MEANINGS
from tissueid.flags import FLAGS, flag_level
from tissueid.quantity_words import QUANTITIES

#: Options that every command has; told once.
COMMON = frozenset({"quiet", "verbose", "json"})


def examples_of(command: click.Command) -> list[str]:
    """Lines of a command's examples as one would type them."""
    _, _, lines = (command.epilog or "").partition("Examples:")
    return [line.strip() for line in lines.strip().splitlines()]


def options_page() -> str:
    """The page."""
    lines = [
        "# Commands and options",
        "",
        "Written by `scripts/write-docs` from the command line itself. Every command also takes `-q` (errors",
        "only), `-v` (more; a bug shows its traceback), `--json` (one JSON document to stdout) and `--help`.",
        "Options can be set in a file or the environment: [configuration.md](configuration.md). Those marked",
        "† are typed each time.",
        "",
    ]
    for name, command in walk(cli):
        if not name:
            continue
        lines += [f"## `tissueid {' '.join(name)}`", "", *_help(command), ""]
        rows = [_row(one) for one in command.params if isinstance(one, click.Option)]
        if any(rows):
            lines += ["| option | what it does |", "|---|---|", *filter(None, rows), ""]
        if not isinstance(command, click.Group):
            lines += ["```", *examples_of(command), "```", ""]
    return "\n".join(lines)


def _help(command: click.Command) -> list[str]:
    return inspect.cleandoc(command.help or "").replace("*", "\\*").replace("<", "&lt;").splitlines()


def _row(option: click.Option) -> str | None:
    """A row of the table; ``None`` for an option that all have."""
    key = option_name(option)
    if key in COMMON:
        return None
    record = option.get_help_record(click.Context(click.Command("tissueid")))
    if record is None:
        return None
    names, words = (part.replace("|", "\\|") for part in record)
    mark = " †" if key in TYPED_ONLY else ""
    return f"| `{names}`{mark} | {words} |"


#: What the functions give and raise, by the module it stands in.
RESULTS = {
    "tissueid.trial": ("Trial",),
    "tissueid.manifest": ("Study",),
    "tissueid.result": ("Identification", "SpecimenFit", "Estimate"),
    "tissueid.uncertainty": ("ParameterUncertainty", "Posterior"),
    "tissueid.store.bundle": ("Bundle",),
    "tissueid.errors": ("TissueidError", "UsageError", "InputError", "NotIdentifiedError", "BundleError"),
}
_HEADING = re.compile(r"^(\w[\w ]*)\n-{3,}$", re.MULTILINE)
_ENTRY = re.compile(r"^(\S.*?)(?: : (.+))?$")
EXAMPLE = """\
```python
import tissueid as ti

trials = ti.read("datasets_synthetic/paper-a-hold-100Hz")
fit = ti.fit(trials, "kelvin-voigt")
print(fit["eta"].value, fit["eta"].stderr, [flag.code for flag in fit.flags])
fit  # in a notebook: a table and a drawing

options = ti.IdentifyOptions(fit=ti.FitOptions(branches=1, stiffness_degree=0))
found = ti.identify(trials, options=options)  # every specimen among the recordings
```
"""


def api_page() -> str:
    """The page."""
    lines = [
        "# From Python",
        "",
        "Written by `scripts/write-docs` from signatures and docstrings. Units are mm, N and s. Names of",
        "`tissueid` are loaded on first use. `Trial`, `Study`, `Identification`, `SpecimenFit`, `Estimate`,",
        "`Posterior` and `Bundle` show themselves in notebooks, without a script and without the network.",
        "",
        EXAMPLE,
        "## `tissueid`",
        "",
    ]
    for name in sorted((one for one in tissueid.__all__ if not one.startswith("_")), key=str.lower):
        lines += _entry(f"tissueid.{name}", getattr(tissueid, name))
    lines += ["## What they give and raise", ""]
    for module, names in RESULTS.items():
        for name in names:
            lines += _entry(f"{module}.{name}", getattr(import_module(module), name))
    return "\n".join(lines)


def _entry(name: str, thing: Any) -> list[str]:
    lines = [f"### `{name}`", ""]
    if not inspect.isclass(thing) or (is_dataclass(thing) and name.endswith("Options")):
        lines += ["```", _signature(name.rpartition(".")[2], thing), "```", ""]
    return [*lines, *_words(inspect.getdoc(thing) or ""), *_methods(thing)]


def _signature(name: str, thing: Any) -> str:
    """The call, one parameter a line where it is long; a default that a factory makes has no name."""
    parameters = [
        re.sub(r": '([^']*)'", r": \1", str(one)).replace("<factory>", "...")
        for one in inspect.signature(thing).parameters.values()
    ]
    kinds = [one.kind for one in inspect.signature(thing).parameters.values()]
    if inspect.Parameter.KEYWORD_ONLY in kinds:
        parameters.insert(kinds.index(inspect.Parameter.KEYWORD_ONLY), "*")
    short = f"{name}({', '.join(parameters)})"
    return short if len(short) <= 90 else "\n".join([f"{name}(", *(f"    {one}," for one in parameters), ")"])


def _words(text: str) -> list[str]:
    """A docstring in Markdown: its sections as lists, without its examples."""
    parts = _HEADING.split(text)
    lines = [*_plain(parts[0]).strip().splitlines(), ""]
    for title, body in zip(parts[1::2], parts[2::2], strict=True):
        if title != "Examples":
            lines += [f"*{title}*", "", *_listed(body.strip("\n")), ""]
    return lines


def _listed(body: str) -> Iterator[str]:
    """``name : type`` with an indented description as one item each."""
    head, rest = "", []
    for line in [*body.splitlines(), "end"]:
        if line.startswith(" ") or not line.strip():
            rest.append(line.strip())
            continue
        if head:
            words = " ".join(filter(None, rest))
            yield f"* {head}: {_plain(words)}" if words else f"* {head}"
        found = _ENTRY.match(line)
        assert found is not None  # noqa: S101 -- a line that is not empty
        name, kind = found.groups()
        head, rest = f"`{name}`" + (f" ({kind})" if kind else ""), []


def _plain(text: str) -> str:
    """Without the marks of reStructuredText."""
    return re.sub(r":\w+:`~?([^`]+)`", r"`\1`", text).replace("``", "`").replace("<", "&lt;")


def _methods(thing: Any) -> list[str]:
    if not inspect.isclass(thing):
        return []
    found = [
        (name, value)
        for name, value in vars(thing).items()
        if not name.startswith("_") and (inspect.isfunction(value) or isinstance(value, property))
    ]
    if not found:
        return []
    lines = ["*Methods and properties*", ""]
    for name, value in found:
        call = "" if isinstance(value, property) else "()"
        first = (inspect.getdoc(value) or "").partition("\n\n")[0].replace("\n", " ")
        lines.append(f"* `{name}{call}`: {_plain(first)}")
    return [*lines, ""]


def flags_page() -> str:
    """``docs/flags.md``, written from the tables."""
    lines = [
        "# Flags, parameters and exit codes in plain words",
        "",
        "Written by `scripts/write-docs`, from the program. `tissueid explain NAME` prints one entry.",
        "",
        "## Exit codes",
        "",
        "| code | meaning | what to do |",
        "|---|---|---|",
        *(f"| {code} | {meaning} | {way} |" for code, (meaning, way) in EXIT_MEANINGS.items()),
        "",
        "## Parameters",
        "",
        "Names of a second or third branch end in `_b2`, `_b3`.",
        "",
        "| parameter | printed as | unit | in words | meaning | depends |",
        "|---|---|---|---|---|---|",
        *(
            f"| `{name}` | {one.symbol} | {one.unit} | {one.title} | {one.meaning} | {one.depends} |"
            for name, one in QUANTITIES.items()
        ),
        "",
        "## Flags",
        "",
        "A flag is a remark with a stable code: in the report, in the terminal, and under `flags` in the",
        "JSON with the numbers behind it. *Serious* puts the result in doubt, *caution* asks for a look,",
        "*note* says what was assumed or done.",
        "",
    ]
    for code, kind in FLAGS.items():
        lines += [
            f"### `{code}`",
            "",
            f"{kind.title} ({flag_level(code)}): {kind.means}.",
            "",
            f"* What follows: {kind.follows}",
            f"* What to do: {kind.remedy}",
            "",
        ]
    return "\n".join(lines)
