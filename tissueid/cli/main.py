"""``tissueid``: sub-commands that are imported one at a time, when they run, and the shell around them."""

from __future__ import annotations

import contextlib
import os
import signal
import sys
from importlib import import_module
from typing import TYPE_CHECKING

import click

from tissueid import __version__
from tissueid.cli.flags import example_lines
from tissueid.cli.output import echo, terminal_line
from tissueid.errors import EXIT_INTERRUPTED, TissueidError, was_interrupted

if TYPE_CHECKING:
    from click.shell_completion import CompletionItem

#: Group of the help -> its sub-commands -> what each does, from ``cli/<name>_command.py`` or by TOGETHER;
#: VISION.md says which promise each group keeps.
GROUPS = {
    "Everyday": {
        "inspect": "Say what a recording holds and how it was read.",
        "fit": "Identify the tissue behind recordings: bundle, numbers, report.",
        "report": "Write the HTML report of a finished fit again.",
        "render": "Feel an identified tissue on a device, or try it on a simulated one.",
        "export": "Write a finished fit in another format.",
        "models": "List the laws that contact models are made of.",
        "status": "Say how far a fit is, also while it goes on.",
        "explain": "Say in plain words what a flag, a parameter or an exit code means.",
    },
    "Study": {
        "study": "Write, check, correct and publish the study file.",
        "cohort": "Say what the specimens of a fit have in common: population, report.",
        "compare": "Say whether identified tissues differ, and whether a hand could feel it.",
        "rupture": "Study tests to rupture: force, work, speed, and what broke the tissue.",
        "watch": "Give a verdict after each test, beside the machine.",
        "validate": "Check that an output folder is one whole run.",
        "migrate": "Bring a folder or a bundle of an earlier version to this one.",
    },
    "Plan": {
        "design": "Plan the protocol of least machine time for a wanted precision.",
        "calibrate-frame": "Measure how far machine and fixture give.",
    },
    "Devices": {
        "devices": "Find, home, test and calibrate haptic devices, or emulate one.",
        "view": "Look at a session in a browser: one that was recorded, or runs elsewhere.",
        "training": "Measure guided sessions: error, angle, time, smoothness, learning.",
    },
    "Proof": {
        "calibrate": "Check whether intervals hold what they claim, for your protocol.",
        "reproduce": "Recompute the two papers this project starts from.",
        "control": "Simulate the adaptive controller of admittance rendering against a tissue.",
        "synth": "Write synthetic recordings with a known truth.",
        "doctor": "Say what this machine can do with tissueid, and what stands in its way.",
        "config": "Say which settings are in force, and where each comes from.",
        "completion": "Complete commands, options and files in your shell.",
    },
}
COMMANDS = {name: meaning for group in GROUPS.values() for name, meaning in group.items()}
#: Module -> commands that stand in it together, each under its name.
TOGETHER = {
    "folder": ("status", "validate", "migrate", "report"),
    "words": ("explain", "models", "doctor"),
    "calibrate": ("calibrate-frame",),
}

#: The matrices of a fit are small: threads of the linear algebra library make it ten times slower by
#: waiting for each other.  Read when numpy is loaded, which is after this.
BLAS_THREADS = ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS")
#: Exit code where the output could not be written.
EXIT_OUTPUT = 6

#: Commands that must work whatever a configuration file says.
UNSET = frozenset({"completion", "config", "doctor", "explain", "models"})
HELP = frozenset({"-h", "--help"})

EXAMPLES = """
tissueid lab_data/*.csv
tissueid fit lab_data/ -o out
tissueid report out
"""


class LazyGroup(click.Group):
    """A group that imports a sub-command only when it is run or asked for help."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Names in the order of :data:`GROUPS`."""
        del ctx
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """The sub-command, imported now."""
        del ctx
        if cmd_name not in COMMANDS:
            return None
        module = next((one for one, names in TOGETHER.items() if cmd_name in names), None)
        found = import_module(f"tissueid.cli.{module or cmd_name}_command")
        command: click.Command = getattr(found, "command" if module is None else cmd_name.replace("-", "_"))
        return command

    def shell_complete(self, ctx: click.Context, incomplete: str) -> list[CompletionItem]:
        """Names with what they do, without importing any of them."""
        if incomplete.startswith("-"):
            return super().shell_complete(ctx, incomplete)
        from click.shell_completion import CompletionItem

        return [
            CompletionItem(name, help=meaning)
            for name, meaning in COMMANDS.items()
            if name.startswith(incomplete)
        ]

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """As click's, with the nearest name suggested."""
        name = args[0] if args else ""
        if name and not name.startswith("-") and name not in COMMANDS:
            from difflib import get_close_matches

            near = get_close_matches(name, COMMANDS, n=1)
            hint = f" Did you mean {near[0]!r}?" if near else ""
            ctx.fail(f"No such command, file or folder {name!r}.{hint}")
        return super().resolve_command(ctx, args)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """List the sub-commands without importing them."""
        del ctx
        for title, group in GROUPS.items():
            with formatter.section(title):
                formatter.write_dl(list(group.items()), col_max=17, col_spacing=2)


@click.command(
    cls=LazyGroup, epilog=example_lines(EXAMPLES), context_settings={"help_option_names": ["-h", "--help"]}
)
@click.version_option(__version__, "--version", prog_name="tissueid", message="%(prog)s %(version)s")
@click.pass_context
def cli(context: click.Context) -> None:
    """Identify the contact mechanics of soft tissue from test-machine recordings.

    `tissueid FILE...` says what recordings hold, as `tissueid inspect FILE...` does.

    Reads exports of Instron Bluehill, Zwick testXpert, spreadsheets and plain CSV; fits a modified
    Kelvin-Voigt contact model; writes numbers with intervals, an HTML report, and a bundle that a
    haptic device can render.
    """
    if os.environ.get("NO_COLOR"):
        context.color = False
    name = context.invoked_subcommand
    if name is not None and name not in UNSET and not (context.obj and HELP & set(context.obj)):
        from tissueid.cli.config_command import as_default_map, settings_of

        context.default_map = as_default_map(settings_of(name))


def with_verb(args: list[str]) -> list[str]:
    """``inspect`` before arguments that name a recording; a command goes before a file of its name."""
    if not args or args[0] in COMMANDS or args[0] in {*HELP, "--version"}:
        return args
    if next((arg for arg in args if not arg.startswith("-")), None) in COMMANDS:
        return args
    looked = args[1:] if args[0].startswith("-") else args[:1]
    return ["inspect", *args] if any(_is_recording(arg) for arg in looked) else args


def _is_recording(arg: str) -> bool:
    """True where an argument is there as a file or folder, or is written as one."""
    name = arg.partition("::")[0]
    written = os.sep in name or "/" in name or "." in name
    return not name.startswith("-") and (os.path.lexists(name) or (written and "=" not in name))


def _interrupted() -> int:
    echo("tissueid: interrupted; what was finished is kept", err=True)
    return EXIT_INTERRUPTED


def _misused(error: click.ClickException, args: list[str]) -> int:
    """Say what click says of the arguments, none of which reaches the terminal as it was typed."""
    context = error.ctx if isinstance(error, click.UsageError) else None
    if context is not None:
        usage = (
            f"{context.get_usage()}\nTry '{context.command_path} {context.help_option_names[0]}' for help.\n"
        )
        for line in usage.split("\n"):
            echo(line, err=True)
    message = error.format_message()
    for arg in filter(None, args):
        message = message.replace(arg, terminal_line(arg))
    for line in f"Error: {message}".split("\n"):
        echo(line, err=True)
    return error.exit_code


def _refused(error: TissueidError) -> int:
    """A deliberate failure, in its own words."""
    echo(f"tissueid: {error}", err=True)
    return error.exit_status


def _broken(error: Exception, args: list[str]) -> int:
    """A bug: one line, and with -v where it is."""
    if any(arg == "--verbose" or (arg.startswith("-v") and set(arg[1:]) == {"v"}) for arg in args):
        import traceback

        for line in traceback.format_exc().splitlines():
            echo(line, err=True)
    echo(
        f"tissueid: internal error ({type(error).__name__}: {error}). This is a bug in tissueid; "
        "run again with -v for the details to report.",
        err=True,
    )
    return 1


def main(args: list[str] | None = None) -> int:
    """Run the command line, the entry point of the console script; returns its exit code."""
    args = with_verb(sys.argv[1:] if args is None else args)
    try:
        outcome = cli.main(args=args, prog_name="tissueid", standalone_mode=False, obj=args)
        sys.stdout.flush()
    except (click.exceptions.Abort, KeyboardInterrupt):
        return _interrupted()
    except click.ClickException as error:
        return _misused(error, args)
    except TissueidError as error:
        return _refused(error)
    except (SystemExit, BrokenPipeError):
        # click and rich raise SystemExit for a pipe whose reader has gone, and for nothing else here:
        # nothing is left to say to it, and what was asked for is done
        with contextlib.suppress(OSError):
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except ModuleNotFoundError as error:
        from tissueid.extras import missing_extra

        needed = missing_extra(error)
        return _broken(error, args) if needed is None else _refused(needed)
    except OSError as error:
        # reading is guarded in ingest: what is left is a full disk or a folder taken away
        echo(f"tissueid: {error.filename or 'output'}: {error.strerror or error}", err=True)
        return EXIT_OUTPUT
    except Exception as error:  # noqa: BLE001 - the outer shell: a bug must still end in one clear line
        return _interrupted() if was_interrupted(error) else _broken(error, args)
    return outcome if isinstance(outcome, int) else 0


def run() -> None:
    """Console-script entry: exit with the code of :func:`main`."""
    for name in BLAS_THREADS:
        os.environ.setdefault(name, "1")
    # a stream that was closed before the start is None: what is said there goes nowhere
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, "w", encoding="utf-8"))  # noqa: SIM115, PTH123
    if signal.getsignal(signal.SIGTERM) is signal.SIG_DFL:
        # a scheduler ends a job so: it is told, and leaves its place, as after Ctrl-C
        signal.signal(signal.SIGTERM, signal.default_int_handler)
    code = main()
    if code == EXIT_INTERRUPTED:
        # an interrupt that passed through exec() of a string would make Python die of the signal instead
        for stream in (sys.stdout, sys.stderr):
            with contextlib.suppress(OSError):
                stream.flush()
        os._exit(code)
    sys.exit(code)


if __name__ == "__main__":
    run()
