"""The command line is a contract: the names, the options and their meanings that people have in their scripts."""

from __future__ import annotations

import json
import os
import shlex
import subprocess
import sys
from typing import TYPE_CHECKING

import pytest
import typer.main

from cyclekit.cli import app

if TYPE_CHECKING:
    from .conftest import Shell

COMMANDS = typer.main.get_command(app()).commands  # type: ignore[attr-defined]
CONTRACT = {
    "simulate": (["scene"], ["--out", "--executions", "--seed", "--operator-log"]),
    "init": (["logs"], ["--takt", "--yes"]),
    "run": (["project"], []),
    "ingest": (["logs"], ["--out", "--cell", "--jobs", "--rate", "--align-clocks", "--keep-skeletons"]),
    "inspect": (["path", "cell_file"], ["--write-cell"]),
    "convert": (["log"], ["--out", "--table", "--rate", "--columns", "--cell"]),
    "trace": (["dataset"], ["--execution", "--at", "--logs"]),
    "levels": (["dataset"], ["--method", "--picture"]),
    "train": (["dataset"], ["--out", "--problem", "--network", "--horizon", "--seed", "--norm", "--noise"]),
    "export": (["model"], ["--out"]),
    "evaluate": (["model", "dataset"], ["--trained-on"]),
    "estimate": (["model", "sequences"], ["--dataset", "--out", "--estimator", "--takt", "--extrapolate"]),
    "gate": (["model", "sequences"], ["--dataset", "--takt", "--share", "--confidence", "--sequence"]),
    "plan": (["model", "jobs"], ["--dataset", "--out"]),
    "zones": (["model", "dataset"], ["--out"]),
    "whatif": (["model", "sequences", "changes"], ["--dataset", "--out"]),
    "replay": (["dataset"], ["--execution", "--out", "--model", "--open"]),
    "report": (["dataset"], ["--model", "--sequences", "--out"]),
    "fleet": (["what", "file"], ["--engine", "--jobs", "--ray-address"]),
    "calibrate": (["points"], ["--up"]),
    "adapters": ([], []),
    "demo": ([], ["--out", "--operator-log"]),
}
HEAVY = {"torch", "polars", "numpy", "sklearn", "rerun", "scipy", "matplotlib", "rosbags", "jinja2", "ruckig"}


def test_the_commands_are_those_of_the_contract() -> None:
    assert set(COMMANDS) == set(CONTRACT)


@pytest.mark.parametrize("name", CONTRACT)
def test_a_command_takes_the_arguments_and_options_of_the_contract(name: str) -> None:
    arguments, options = CONTRACT[name]
    parameters = COMMANDS[name].params
    assert [p.name for p in parameters if p.param_type_name == "argument"] == arguments
    known = {option for p in parameters for option in p.opts}
    assert {*options, "--json", "--quiet"} <= known


@pytest.mark.parametrize("name", CONTRACT)
def test_the_help_shows_an_example_that_parses(name: str, cyclekit: Shell) -> None:
    shown = cyclekit(name, "--help")
    assert shown.code == 0
    lines = [line.strip() for line in shown.out.splitlines() if line.strip().startswith(f"cyclekit {name}")]
    assert len(lines) == 1, shown.out
    words = shlex.split(lines[0])[2:]
    context = COMMANDS[name].make_context(name, words)  # parses and checks, runs nothing
    assert {option for option in words if option.startswith("--")} <= {o for p in COMMANDS[name].params for o in p.opts}
    context.close()


@pytest.mark.parametrize("name", CONTRACT)
def test_the_help_fits_80_columns_and_is_plain(name: str, cyclekit: Shell) -> None:
    shown = cyclekit(name, "--help").out
    body, _, example = shown.partition("Example:")
    assert max(len(line) for line in body.splitlines()) <= 80
    assert example.strip()
    assert "\x1b" not in shown


def test_help_imports_no_library_of_the_work() -> None:
    code = (
        "import sys, json; from cyclekit.cli import run\n"
        f"asked = [[], *([name] for name in {list(CONTRACT)!r})]\n"
        "found = [(words, run([*words, '--help']), sorted(sys.modules)) for words in asked]\n"
        "print(json.dumps(found), file=sys.stderr)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    found = json.loads(done.stderr.splitlines()[-1])
    assert len(found) == 1 + len(CONTRACT)
    for words, returned, loaded in found:
        assert (returned, HEAVY.intersection(loaded)) == (0, set()), words


def test_estimates_import_nothing_of_the_page_and_of_logs() -> None:
    """Each takes a twentieth of the time of an estimate."""
    code = (
        "import sys; from cyclekit.api import estimate, given, inspect; from cyclekit.report import texts, verdict;"
        "print(*sorted(sys.modules))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    unused = {"jinja2", "scipy.ndimage", "cyclekit.report.page", "cyclekit.inspect.describe"}
    assert not unused.intersection(done.stdout.split())


def test_help_answers_in_half_a_second_of_processor_time() -> None:
    code = (
        "import time, sys; from cyclekit.cli import run; run(['train', '--help']);"
        "print(time.process_time(), file=sys.stderr)"
    )
    spent = [
        float(subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stderr)
        for _ in range(3)
    ]
    assert min(spent) < 0.5


def test_the_version_is_that_of_the_package(cyclekit: Shell) -> None:
    import cyclekit as package

    assert cyclekit("--version").out == f"cyclekit {package.__version__}\n"


def test_a_shell_completes_commands() -> None:
    asked = {"COMP_WORDS": "cyclekit gat", "COMP_CWORD": "1", "_CYCLEKIT_COMPLETE": "complete_bash"}
    words = [sys.executable, "-m", "cyclekit"]
    done = subprocess.run(words, capture_output=True, text=True, check=True, env={**os.environ, **asked})
    assert done.stdout.split() == ["gate"]
