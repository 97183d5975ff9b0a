"""The command line: each command parses its arguments, calls one function of the library, and prints the result.

    exit 0   success
    exit 1   error of cyclekit: one message on standard error, `error: cause, file or argument, cure`
    exit 2   invalid command line
    exit 130 interrupted

The exit code of `gate` is its verdict, 0 or 1; its errors exit with 2.

With `--json`, standard output holds exactly one JSON document, also on failure; all other text goes to standard error.
A traceback means a bug of cyclekit. Each command can be replaced by one Python call, that of its library function.
"""

from __future__ import annotations

import gc
import os
import sys
import warnings
from typing import TYPE_CHECKING

from cyclekit.cli.surroundings import (
    check_working_directory,
    complete_streams,
    drop_output,
    explained,
    flush,
    is_of_output,
    restart_in_utf8,
    with_home,
)

if TYPE_CHECKING:
    from collections.abc import Sequence

    import typer

DAILY = (
    *("demo", "init", "run", "inspect", "ingest", "train", "estimate"),
    *("gate", "plan", "whatif", "zones", "replay", "report"),
)
TOOLS = ("fleet", "calibrate", "trace", "convert", "levels", "evaluate", "export", "simulate", "adapters")
ORDER = (*DAILY, *TOOLS)
"""Commands of every day and tools, in the order of the workflow; each is a module of this package with a function of
the same name."""
MODULES = {"run": "run_project"}
"""Modules whose name differs from the command: a module `run` would hide the function `run` of this package."""


def main(arguments: Sequence[str] | None = None) -> None:
    """Run one command line and exit the process with its exit code.

    Args:
        arguments: Words after `cyclekit`; None = those of the process.
    """
    if arguments is None:
        restart_in_utf8()
        if not sys.warnoptions:  # `python -W` and PYTHONWARNINGS take precedence
            without_warnings_of_libraries()
    complete_streams()
    code = run(list(sys.argv[1:] if arguments is None else arguments))
    gc.freeze()  # garbage collection of all imports at exit takes a tenth of a short command's time
    sys.exit(code)


def without_warnings_of_libraries() -> None:
    """Hide Python warnings of libraries, in this process and its children; they are meant for programmers.

    Warnings for users are part of the result.
    """
    warnings.simplefilter("ignore")
    os.environ["PYTHONWARNINGS"] = "ignore"


def run(words: list[str]) -> int:
    """Run one command line and return its exit code; it raises only if cyclekit has a bug.

    Args:
        words: Words after `cyclekit`.
    """
    try:
        return _run(words)
    except OSError as error:
        return _refused(error, as_json="--json" in words, code=_code_of_errors(words))
    except MemoryError as error:
        return _too_large(error, as_json="--json" in words, code=_code_of_errors(words))


def _code_of_errors(words: list[str]) -> int:
    return 2 if words[:1] == ["gate"] else 1


def _run(words: list[str]) -> int:
    import typer

    from cyclekit.cli.terminal import say_failure, say_usage
    from cyclekit.errors import CyclekitError

    as_json = "--json" in words
    try:
        check_working_directory()
        words = with_home(words)
        wanted = words[:1] if words and words[0] in ORDER else ORDER
        code = app(wanted)(args=words or ["--help"], prog_name="cyclekit", standalone_mode=False)
        flush()
    except CyclekitError as error:
        return say_failure(str(error), kind=type(error).__name__, as_json=as_json, code=_code_of_errors(words))
    except typer.TyperException as error:
        return say_usage(error, as_json=as_json)
    except (KeyboardInterrupt, typer.Abort):
        return say_failure("interrupted", kind="Interrupted", as_json=as_json, code=130)
    finally:
        if not {"--quiet", "-q"}.intersection(words):
            _say_left_out()
    if code == 130:  # typer caught the interruption itself
        return say_failure("interrupted", kind="Interrupted", as_json=as_json, code=130)
    return code if isinstance(code, int) else 0


def _say_left_out() -> None:
    """Warn once about adapters that failed to load, if the command searched for adapters."""
    if (registry := sys.modules.get("cyclekit.ingest.registry")) is None:
        return
    from cyclekit.cli.terminal import Terminal

    Terminal(json=False, quiet=False).warnings([str(adapter) for adapter in registry.noticed()])


def _refused(error: OSError, *, as_json: bool, code: int) -> int:
    """Print the error of the operating system and return the exit code; a closed pipe is not reported."""
    from cyclekit.cli.terminal import say_failure

    if isinstance(error, BrokenPipeError):
        drop_output()
        return code
    if is_of_output(error):  # then no JSON document can be written either
        drop_output()
    return say_failure(explained(error), kind="SystemRefused", as_json=as_json, code=code)


def _too_large(error: MemoryError, *, as_json: bool, code: int) -> int:
    from cyclekit.cli.terminal import say_failure
    from cyclekit.errors import CyclekitError

    why = f" ({error})" if str(error) else ""
    cure = "Work on fewer logs at a time, a month of them say, or on a machine with more memory."
    seen = f"this needs more memory than the process may take{why}"
    return say_failure(str(CyclekitError(seen, cure=cure)), kind="MemoryError", as_json=as_json, code=code)


def app(wanted: Sequence[str] = ORDER) -> typer.Typer:
    """Return the command line with only the given commands, because importing each takes milliseconds."""
    from importlib import import_module

    from cyclekit.cli.in_project import InProject
    from cyclekit.cli.options import new_app

    commands = new_app(tools=TOOLS)
    for command in wanted:
        module = import_module(f"cyclekit.cli.{MODULES.get(command, command)}")
        epilog = f"\b\nExample:\n  {module.EXAMPLE}"
        commands.command(command, cls=InProject, epilog=epilog)(getattr(module, command))
    return commands
