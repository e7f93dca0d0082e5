"""Every command and group explains itself with examples, and every example can be typed."""

from __future__ import annotations

import re
import shlex

import click
import pytest
from command_line import REPOSITORY, run
from reference_pages import examples_of, flags_page, options_page

from tissueid.cli.flags import walk
from tissueid.cli.main import cli, with_verb

WALKED = list(walk(cli))
EXAMPLES = [(line, name) for name, command in WALKED for line in examples_of(command)]


def words_of(line: str) -> list[str]:
    """The words of an example, without a remark, a redirection or a pipe behind it."""
    typed = re.split(r"\s{2,}|\s[>|]\s", line)[0]
    return shlex.split(typed)


def any_path(monkeypatch: pytest.MonkeyPatch) -> None:
    """Files of examples need not be there."""
    monkeypatch.setattr(click.Path, "convert", lambda _self, value, _parameter, _context: value)


@pytest.fixture(autouse=True)
def _of_examples(monkeypatch):
    any_path(monkeypatch)


def unfit(line: str) -> str | None:
    """Why an example could not be typed; ``None`` where it can."""
    name, *rest = words_of(line)
    rest = with_verb(rest)
    command: click.Command = cli
    context: click.Context | None = None
    try:
        while isinstance(command, click.Group):
            context = command.make_context(name, rest, parent=context)
            name, found, rest = command.resolve_command(context, [*context._protected_args, *context.args])  # type: ignore[assignment]
            if found is None:
                return "no such command"
            command = found
        command.make_context(name, rest, parent=context)
    except click.exceptions.Exit:
        return None
    except click.UsageError as error:
        return error.format_message()
    return None


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


def test_an_example_can_be_typed_and_what_cannot_is_found():
    assert [line for line, _ in EXAMPLES if unfit(line) is not None] == []
    assert [line for line in UNFIT if unfit(line) is None] == []


def test_every_option_has_words():
    silent = [
        f"{' '.join(name)} {option.opts[-1]}"
        for name, command in WALKED
        for option in command.params
        if isinstance(option, click.Option) and not option.help
    ]
    assert silent == []


@pytest.mark.parametrize(("page", "made"), [("options", options_page), ("flags", flags_page)])
def test_a_page_is_that_of_the_program(page, made):
    written = (REPOSITORY / "docs" / f"{page}.md").read_text(encoding="utf-8")
    assert written == made(), "run scripts/write-docs"
