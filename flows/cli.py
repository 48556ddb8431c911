"""``gvr``: the command line.

Modules with commands import what they work with when they are called: help and completion answer
at once.
"""

from __future__ import annotations

import signal
import sys
from typing import Any, NoReturn

import typer

from flows.cache_cli import cache_app
from flows.datasets_cli import datasets_app
from flows.exit_codes import EXIT_BAD_INPUT, EXIT_FAILED
from flows.init_cli import init
from flows.leaving import run_and_leave
from flows.lessons import taught
from flows.models_cli import models_app
from flows.options import JsonOption
from flows.output import complain
from flows.places import store_root
from flows.results_cli import add_results_commands
from flows.run_cli import add_run_commands
from flows.view_cli import view
from gvr_core.errors import GVRError, InputError

# Typer brings a click of its own or takes the installed one, by its version; in both the error of
# a bad parameter is a kind of the error of a bad command line.
USAGE_ERROR: type[Any] = typer.BadParameter.__mro__[1]

app = typer.Typer(
    name="gvr",
    help="Batch evaluation of text-driven visual grounding in 3D Gaussian Splatting scenes.",
    epilog="Every command has a --help with examples; docs/command_line.md has them all.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def doctor(as_json: JsonOption = False) -> None:
    """Check this machine: versions, models, data, renderer, store."""
    from flows import doctor as doctor_commands

    raise typer.Exit(doctor_commands.doctor(store_root(), as_json))


app.command(**taught("init"))(init)
app.command(**taught("doctor"))(doctor)
add_run_commands(app)
app.command(**taught("view"))(view)
add_results_commands(app)
app.add_typer(cache_app, name="cache", **taught("cache"))
app.add_typer(models_app, name="models", **taught("models"))
app.add_typer(datasets_app, name="datasets", **taught("datasets"))


def script() -> NoReturn:
    """``gvr`` as a process of its own."""
    run_and_leave(main)


def main(arguments: list[str] | None = None) -> None:
    """A command line: what goes wrong becomes one line and an exit code."""
    # Ending by SIGTERM unwinds like Ctrl-C, so that servers that were started are stopped.
    signal.signal(signal.SIGTERM, lambda number, frame: sys.exit(128 + number))
    try:
        code = app(args=arguments, prog_name="gvr", standalone_mode=False)
    except InputError as error:
        complain(str(error))
        sys.exit(EXIT_BAD_INPUT)
    except GVRError as error:
        complain(str(error))
        sys.exit(EXIT_FAILED)
    except USAGE_ERROR as error:
        _complain_of_usage(error)
        sys.exit(EXIT_BAD_INPUT)
    except typer.Abort:
        complain("interrupted")
        sys.exit(128 + signal.SIGINT)
    if code:
        sys.exit(code)


def _complain_of_usage(error: Any) -> None:
    """One line on a command line that cannot be, and where to read on."""
    command = error.ctx.command_path if error.ctx is not None else "gvr"
    text = " ".join(str(error.format_message()).split())
    if text:  # none where the help was printed instead
        complain(f"{text} (see: {command} --help)")
