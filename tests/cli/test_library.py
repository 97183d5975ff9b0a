"""The library: one function for each command, the same numbers as the command, and arguments that say what is wrong."""

from __future__ import annotations

import ast
import inspect
import json
import re
import shutil
from pathlib import Path
from typing import TYPE_CHECKING

import polars as pl
import pytest
from matplotlib.figure import Figure

import cyclekit as library
from cyclekit.api.arguments import checked
from cyclekit.cli import MODULES, ORDER
from cyclekit.errors import CyclekitError, EstimateError, UnknownName, WrongType
from cyclekit.estimate.answers import CycleEstimates, Refusal
from cyclekit.estimate.plan import OrderPlan
from cyclekit.estimate.result import CycleEstimate, TaskShare
from cyclekit.fleet.run import FleetRun
from cyclekit.fleet.stages import StageResult
from cyclekit.text.results import Result
from cyclekit_sim.task_lists import simulate_task_lists

if TYPE_CHECKING:
    from .conftest import Shell

ROOT = Path(__file__).parents[2]
FUNCTIONS = sorted(name for name, home in library._HOMES.items() if re.match(r"cyclekit\.(api|fleet)\..*:[a-z]", home))
PAGE = (ROOT / "docs" / "library.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"^```python\n(.*?)^```", PAGE, re.MULTILINE | re.DOTALL)
POINTS = "log_x_m,log_y_m,log_z_m,base_x_m,base_y_m,base_z_m\n0,0,0,1,0,0\n1,0,0,2,0,0\n0,1,0,1,1,0\n0,0,1,1,0,1\n"
FLEET = '[fleet]\nout = "fleet"\n[[cell]]\nname = "a"\nsources = ["logs"]\n'
CHANGE = '[[change]]\nname = "small"\nlevels = [0.0, 0.25, 0.5, 0.75, 1.0]\nthresholds_m = [0.6, 0.8, 1.2, 1.6]\n'


@pytest.fixture(scope="module")
def cell(tmp_path_factory: pytest.TempPathFactory, logs: Path, dataset: Path, model: Path, sequences: Path) -> Path:
    """A folder that holds what the examples name."""
    folder = tmp_path_factory.mktemp("library")
    for made in (logs, dataset, model):
        shutil.copytree(made, folder / made.name)
    shutil.copyfile(sequences, folder / "sequences.toml")
    shutil.copyfile(next(logs.glob("**/*robot*.csv")), folder / "robot.csv")
    simulate_task_lists(folder / "lists", executions=6, seed=1)
    shutil.move(folder / "lists" / "tasks.csv", folder / "tasks.csv")
    (folder / "points.csv").write_text(POINTS, encoding="utf-8")
    (folder / "changes.toml").write_text(CHANGE, encoding="utf-8")
    (folder / "fleet.toml").write_text(FLEET, encoding="utf-8")
    return folder


@pytest.mark.slow
@pytest.mark.usefixtures("words_only")
def test_the_examples_of_the_page_run_and_show_every_function(
    cell: Path, jobs: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    shutil.copyfile(jobs, cell / "jobs.toml")
    monkeypatch.chdir(cell)
    for block in BLOCKS:
        exec(compile(block, "docs/library.md", "exec"), {})
    assert "executions" in capsys.readouterr().out
    called = {node.id for block in BLOCKS for node in ast.walk(ast.parse(block)) if isinstance(node, ast.Name)}
    assert set(FUNCTIONS) - called == set()


def test_the_page_names_a_function_for_every_command() -> None:
    rows = dict(re.findall(r"^\| `(\w+)` \| (.*?) \|", PAGE, re.MULTILINE))
    assert set(rows) == set(ORDER) - {"demo", "benchmark"}
    named = {name for text in rows.values() for name in re.findall(r"`(\w+)`", text)}
    assert named == set(FUNCTIONS)


@pytest.mark.parametrize("name", FUNCTIONS)
def test_a_wrong_type_is_named_with_what_came_and_what_was_expected(name: str) -> None:
    function = getattr(library, name)
    for parameter in inspect.signature(function).parameters.values():
        given = {p.name: "x" for p in inspect.signature(function).parameters.values() if p.default is p.empty}
        with pytest.raises(WrongType) as raised:
            function(**{**given, parameter.name: object()})
        assert isinstance(raised.value, TypeError)
        text = str(raised.value)
        assert text.startswith(f"{name}(): ")
        assert "is of type object; expected " in text or parameter.name not in text


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (
            lambda: library.estimate_cycles("m", dataset=3, sequences="s"),
            "dataset = 3 is of type int; expected Dataset, str or Path",
        ),
        (
            lambda: library.write_report("d", "r.html", takt_s="105s"),
            "takt_s = '105s' is of type str; expected float or",
        ),
        (lambda: library.train_model("d", {"seed": 1}), "is of type dict; expected ModelSpec or None"),
        (lambda: library.plan_order("m", "d", "j", seed=True), "seed = True is of type bool; expected int"),
        (lambda: library.ingest_logs(["a", 3], "d"), "is of type list; expected str, Path or a list of str or Path"),
    ],
)
def test_a_wrong_argument_is_named(call: object, said: str) -> None:
    with pytest.raises(WrongType, match=re.escape(said)):
        call()  # type: ignore[operator]


def test_files_are_read_from_a_text_as_from_a_path(tmp_path: Path) -> None:
    jobs = 'start = "home"\nvisit = ["a", "b"]\n'
    files = {"sequences": '[[sequence]]\nplaces = ["a", "b"]\n', "jobs": jobs, "changes": CHANGE}
    for name, text in files.items():
        file = tmp_path / f"{name}.toml"
        file.write_text(text, encoding="utf-8")
        load = getattr(library, f"load_{name}")
        assert load(str(file)) == load(file)
        with pytest.raises(CyclekitError, match="nowhere"):
            load("nowhere.toml")


def test_a_text_that_is_none_of_the_known_ones_shows_the_nearest() -> None:
    with pytest.raises(UnknownName, match="the nearest is 'plateau'"):
        library.find_levels("d", method="plateu")


def test_integers_of_numpy_are_integers_and_a_bool_is_none() -> None:
    import numpy as np

    @checked
    def twice(count: int, share: float = 1.0) -> float:
        return 2 * count * share

    assert twice(np.int64(3), np.float32(0.5)) == 3
    with pytest.raises(WrongType, match="count = True is of type bool; expected int"):
        twice(True)


@pytest.mark.parametrize(
    ("words", "call"),
    [
        (("inspect", "nowhere"), lambda: library.inspect_logs("nowhere")),
        (("ingest", "nowhere", "--out", "d"), lambda: library.ingest_logs("nowhere", "d")),
        (("evaluate", "nowhere", "d"), lambda: library.evaluate_model("nowhere", "d")),
        (
            ("estimate", "m", "nowhere.toml", "--dataset", "d"),
            lambda: library.estimate_cycles("m", "d", "nowhere.toml"),
        ),
        (("convert", "no.csv", "--out", "a.csv"), lambda: library.convert_log("no.csv", "a.csv")),
        (("fleet", "all", "nowhere.toml"), lambda: library.run_fleet("nowhere.toml")),
    ],
)
def test_what_is_not_there_is_said_as_the_command_says_it(
    words: tuple[str, ...], call: object, cyclekit: Shell, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    typed = cyclekit(*words)
    with pytest.raises(CyclekitError) as raised:
        call()  # type: ignore[operator]
    assert typed.code == 1
    assert typed.err.strip().endswith(f"error: {raised.value}")


def test_the_command_prints_what_the_function_returns(
    model: Path, dataset: Path, sequences: Path, cyclekit: Shell
) -> None:
    found = library.estimate_cycles(str(model), dataset, sequences)
    typed = cyclekit("estimate", model, sequences, "--dataset", dataset, "--json", "--quiet")
    assert json.loads(json.dumps(found.to_dict())) == typed.document
    assert found.to_frame()["expected_s"].to_list() == [one.expected_s for one in found]
    assert library.estimate_cycles(library.load_model(model), library.Dataset.open(dataset), sequences) == found


def hostile() -> list[Result]:
    name = "<script>\n\x1b[31m"
    share = TaskShare(name, 2.0, 1.0, 0.5, 0.5, 0.0)
    one = CycleEstimate(name, ("a", name), *[2.0] * 3, None, 1.0, 0.5, 0.5, 0.0, 1.0, 1, (), (share,), {}, (2.0,))
    refused = Refusal("B", EstimateError("B: never logged"))
    row = StageResult(name, "ingest", "failed", name)
    return [one, CycleEstimates((one,), (refused,)), FleetRun(name, (row,), None)]


@pytest.mark.parametrize("result", hostile(), ids=lambda result: type(result).__name__)
def test_a_result_is_short_in_a_console_and_escaped_in_a_notebook(result: Result) -> None:
    assert repr(result).startswith(f"{type(result).__name__}: ")
    assert len(repr(result)) < 600
    assert "\x1b" not in repr(result)
    page = result._repr_html_()
    assert "<script>" not in page
    assert page.count("<tr>") == page.count("</tr>") == 1 + result.to_frame().height
    assert isinstance(result.to_frame(), pl.DataFrame)
    assert json.dumps(result.to_dict())


CALLS = {
    "logs": lambda: library.inspect_logs("logs"),
    "dataset": lambda: library.inspect_logs("dataset", verify=True),
    "model": lambda: library.inspect_logs("model"),
    "draft": lambda: library.draft_cell("logs"),
    "convert": lambda: library.convert_log("robot.csv", "robot.parquet", rate_hz=1),
    "levels": lambda: library.find_levels("dataset"),
    "trace": lambda: library.trace_sample("dataset", "1"),
    "adapters": library.list_adapters,
    "calibrate": lambda: library.calibrate_tracker("points.csv"),
    "zones": lambda: library.read_safety_function("model", "dataset"),
    "evaluate": lambda: library.evaluate_model("model", "dataset", boosting=False),
    "models": lambda: library.evaluate_models("model", "dataset", boosting=False),
    "trained": lambda: library.load_model("model"),
    "replay": lambda: library.write_replay("dataset", 1, "replay.rrd", model="model"),
}


@pytest.mark.parametrize("name", CALLS)
def test_every_result_has_a_short_repr_a_frame_and_a_dict(
    name: str, cell: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(cell)
    found = CALLS[name]()
    assert isinstance(found, Result)
    assert len(repr(found).splitlines()) <= 8
    assert len(repr(found)) < 1500
    rows = min(found.to_frame().height, 20)
    assert found._repr_html_().count("<tr>") == (1 + rows if rows else 0)  # no head of a table without rows
    assert json.loads(json.dumps(found.to_dict()))


DRAWN = {
    "dataset": (lambda: library.Dataset.open("dataset"), "time, s"),
    "model": (lambda: library.load_model("model"), "mean squared error"),
    "estimate": (lambda: hostile()[0], ""),
    "estimates": (lambda: hostile()[1], ""),
    "zones": (lambda: library.read_safety_function("model", "dataset"), "robot speed (scaling)"),
}


@pytest.mark.parametrize("name", DRAWN)
def test_a_notebook_shows_it_as_a_table_and_a_figure(name: str, cell: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(cell)
    make, label = DRAWN[name]
    found = make()
    assert found._repr_html_().count("<tr>") > 1
    figure = found.plot()
    assert isinstance(figure, Figure)
    assert figure.axes[0].get_ylabel() == label
    assert any(axes.has_data() for axes in figure.axes)
    assert figure._repr_png_().startswith(b"\x89PNG")


def test_the_figure_of_an_order_says_both_means_and_the_interval() -> None:
    plan = OrderPlan(
        ("b", "a"), ("b", "a"), 20.0, "logged orders", 25.0, (5.0, 4.0, 6.0), "all orders", 2, 9, 19.0, 21.0
    )
    (axes,) = plan.plot().axes
    assert [bar.get_width() for bar in axes.patches] == [20.0, 25.0]
    assert list(axes.lines[0].get_xdata()) == [19.0, 21.0]
    assert [text.get_text() for text in axes.get_yticklabels()] == ["order found", "logged orders"]


def test_what_was_not_answered_is_shown_and_may_be_demanded() -> None:
    found = next(result for result in hostile() if isinstance(result, CycleEstimates))
    assert "not answered: B: never logged" in repr(found)
    with pytest.raises(EstimateError, match="never logged"):
        found.require_all()


def imported(file: Path) -> set[str]:
    """Modules of cyclekit that a file imports when it runs."""
    tree = ast.parse(file.read_text(encoding="utf-8"))
    typing = {inner for node in tree.body if isinstance(node, ast.If) for inner in ast.walk(node)}
    return {str(node.module) for node in ast.walk(tree) if isinstance(node, ast.ImportFrom) and node not in typing}


_ROOMS = ("calibrate", "convert", "dataset", "discover", "estimate.rollout", "evaluate", "guard", "models.saved")
BEHIND = {f"cyclekit.{room}" for room in (*_ROOMS, "registry", "report", "storage", "trace", "train")}


@pytest.mark.parametrize("command", sorted(set(ORDER) - {"demo", "benchmark"}))
def test_a_command_calls_the_library_and_nothing_behind_it(command: str) -> None:
    used = imported(ROOT / "cyclekit" / "cli" / f"{MODULES.get(command, command)}.py")
    assert used & BEHIND == set()
    assert f"cyclekit.api.{command}" in used or command in {"fleet", "run"}


def test_the_fleet_calls_the_library_and_nothing_behind_it() -> None:
    used = imported(ROOT / "cyclekit" / "fleet" / "stages.py")
    answers = {
        "cyclekit.ingest.ingest",
        "cyclekit.learning.training",
        "cyclekit.estimate.rollout",
        "cyclekit.learning.evaluation.evaluate",
        "cyclekit.report",
    }
    assert used & answers == set()
