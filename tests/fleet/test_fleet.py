"""A fleet: what is new of every cell, one broken cell among good ones, lost workers, and the page of all."""

from __future__ import annotations

import datetime as dt
import json
import multiprocessing
import os
import re
import shutil
import signal
import threading
import time
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from ingested import without_checksums
from msgspec.structs import replace

from cyclekit import fleet as fleets
from cyclekit.cli import run
from cyclekit.dataset.cards import FiguresCard, SplitCard, TrainingCard
from cyclekit.dataset.dataset import Dataset
from cyclekit.errors import ConfigError, UnknownName
from cyclekit.fleet.months import day_in, days_of, since_last_month, since_training
from cyclekit.fleet.stages import run_stages
from cyclekit.learning.networks.saved import load_model
from cyclekit.parallel.engine import Engine
from cyclekit.report.fleet_page import CellLine, fleet_page

if TYPE_CHECKING:
    from cyclekit.fleet import Fleet, StageResult

pytestmark = pytest.mark.usefixtures("words_only", "simple_rules")

TODAY = dt.date(2026, 11, 21)


def fleet_of(folder: Path, logs: Path, *cells: str, more: str = "") -> Path:
    """Write a fleet file of cells with the same logs each, copied; a cell called `broken` has notes in their place."""
    text = f'[fleet]\nname = "Line 4"\nout = "out"\nepochs = 2\n{more}\n'
    for name in cells:
        text += f'[[cell]]\nname = "{name}"\nsources = ["logs/{name}"]\n'
        if name == "broken":
            (folder / "logs" / name).mkdir(parents=True)
            (folder / "logs" / name / "notes.txt").write_text("it squeaks")
        else:
            shutil.copytree(logs, folder / "logs" / name)
    (folder / "fleet.toml").write_text(text, encoding="utf-8")
    return folder / "fleet.toml"


def states(rows: list[StageResult]) -> dict[str, str]:
    return {f"{row.cell} {row.stage}": row.state for row in rows}


@pytest.fixture
def one_day(small_cell: Path, tmp_path: Path) -> Path:
    """The logs of three executions."""
    shutil.copytree(small_cell / "logs" / "day_0", tmp_path / "one" / "2026-11-03")
    shutil.copy(small_cell / "logs" / "cell.toml", tmp_path / "one")
    return tmp_path / "one"


def test_one_command_makes_everything_and_a_broken_cell_does_not_hold_up_the_others(
    one_day: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = fleet_of(tmp_path, one_day, "press-1", "broken", more='sequences = "asked.toml"')
    (tmp_path / "asked.toml").write_text('[[sequence]]\nname = "only there"\nplaces = ["home", "conveyor"]')
    assert run(["fleet", "all", str(file), "--json"]) == 1
    told = capsys.readouterr()
    document = json.loads(told.out)
    found = {f"{row['cell']} {row['stage']}": row["state"] for row in document["rows"]}
    assert found == {
        "press-1 ingest": "done", "press-1 train": "done", "press-1 report": "done",
        "broken ingest": "failed", "broken train": "skipped", "broken report": "skipped",
    }  # fmt: skip
    assert "failed: broken: ingest: " in told.err
    assert "no adapter recognises" in told.err
    out = tmp_path / "out"
    page = (out / "index.html").read_text(encoding="utf-8")
    assert '<a href="press-1/report.html">press-1</a>' in page
    assert "Failed in ingest: " in page
    assert "only there" in (out / "press-1" / "report.html").read_text(encoding="utf-8")
    assert Dataset.open(out / "press-1" / "dataset").executions.height == 3
    assert load_model(out / "press-1" / "model").problem == "now"
    known = json.loads((out / "press-1" / "cell.json").read_text(encoding="utf-8"))
    assert known["days"] == {"2026-11-03": "2026-11-03"}
    assert 0.1 < known["figures"]["lost_share"] < 0.9
    again = fleets.run_fleet(fleets.load_fleet(file), list(fleets.STAGES)).rows
    assert [state for name, state in states(again).items() if name.startswith("press")] == ["unchanged"] * 3
    # the other executions had nobody beside the robot: today's cycle is of this order alone
    card_file = without_checksums(out / "press-1" / "dataset") / "dataset.json"
    card = json.loads(card_file.read_text(encoding="utf-8"))
    own, *others = card["executions"]
    for one in others:
        one["reference"] = True
    card_file.write_text(json.dumps(card), encoding="utf-8")
    asked = f'[[sequence]]\nname = "as now"\nplaces = {own["places"]}\n'
    (tmp_path / "asked.toml").write_text(asked, encoding="utf-8")
    (row,) = fleets.run_fleet(fleets.load_fleet(file), ["report"]).rows[:1]
    assert "“as now” is today's own order" in row.text  # and what its estimate differs by is no saving
    pages = [file.read_text(encoding="utf-8") for file in (out / "index.html", out / "press-1" / "report.html")]
    assert not [page for page in pages if re.search(r"saving [\d.]+|[Ss]aves [\d.]+", page.rpartition("<body>")[2])]


@pytest.mark.slow
def test_a_worker_that_is_killed_in_mid_work_costs_a_retry_and_nothing_else(one_day: Path, tmp_path: Path) -> None:
    file = fleet_of(tmp_path, one_day, "a", "b")
    wanted, rows = fleets.load_fleet(file), list[fleets.StageResult]()
    work = threading.Thread(
        target=lambda: rows.extend(fleets.run_fleet(wanted, ["ingest"], engine=Engine(jobs=2)).rows)
    )
    work.start()
    killed = None
    while killed is None and work.is_alive():
        building = [*tmp_path.glob("out/*/.dataset.new-*")]
        pids = {int(folder.name.split("-")[1]) for folder in building}
        for worker in multiprocessing.active_children():
            if worker.pid in pids:
                os.kill(worker.pid, getattr(signal, "SIGKILL", signal.SIGTERM))
                killed = worker.pid
        time.sleep(0.005)
    work.join()
    assert killed is not None
    assert states(rows) == {"a ingest": "done", "b ingest": "done"}
    tables = [
        {f.relative_to(place): f.read_bytes() for f in place.rglob("*.parquet")}
        for place in tmp_path.glob("out/*/dataset")
    ]
    assert tables[0] == tables[1]
    assert not [*tmp_path.glob("out/*/.dataset.new-*")]


@pytest.mark.slow
def test_new_logs_are_added_and_the_model_is_kept_while_the_cell_is_the_same(
    one_day: Path, small_cell: Path, tmp_path: Path
) -> None:
    file = fleet_of(tmp_path, one_day, "press-1")
    wanted = fleets.load_fleet(file)
    fleets.run_fleet(wanted, ["ingest", "train"])
    before = (tmp_path / "out" / "press-1" / "model" / "model.json").read_bytes()
    shutil.copytree(small_cell / "logs" / "day_1", tmp_path / "logs" / "press-1" / "2026-11-04")
    rows = fleets.run_fleet(wanted, ["ingest", "train"]).rows
    assert states(rows) == {"press-1 ingest": "done", "press-1 train": "unchanged"}
    assert rows[0].text.startswith("6 executions, 3 recordings read")
    assert (tmp_path / "out" / "press-1" / "model" / "model.json").read_bytes() == before


@pytest.mark.slow  # quick: logs in a bucket, in test_storage
def test_a_fleet_at_a_url_needs_no_folder_that_machines_share(
    bucket: str, one_day: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("CYCLEKIT_CACHE", str(tmp_path / "cache"))
    file = fleet_of(tmp_path, one_day, "press-1")
    file.write_text(file.read_text().replace('out = "out"', f'out = "{bucket}/fleet"'))
    rows = fleets.run_fleet(fleets.load_fleet(file), ["ingest", "report"]).rows
    assert states(rows) == {"press-1 ingest": "done", "press-1 report": "done"}
    monkeypatch.setenv("CYCLEKIT_CACHE", str(tmp_path / "another"))
    assert Dataset.open(f"{bucket}/fleet/press-1/dataset").executions.height == 3
    from cyclekit.storage.remote.folders import read_text

    assert "press-1/report.html" in (read_text(f"{bucket}/fleet/index.html") or "")
    assert "<html" in (read_text(f"{bucket}/fleet/press-1/report.html") or "")


def test_a_sequence_file_that_is_not_there_fails_the_report_and_nothing_else(one_day: Path, tmp_path: Path) -> None:
    file = fleet_of(tmp_path, one_day, "press-1", more='sequences = "asked.toml"')
    rows = fleets.run_fleet(fleets.load_fleet(file), ["ingest", "report"]).rows
    assert states(rows) == {"press-1 ingest": "done", "press-1 report": "failed"}
    assert "asked.toml: no such file" in rows[1].text


def test_a_sequence_that_cannot_be_estimated_fails_the_report_and_keeps_the_figures(
    small_cell: Path, tmp_path: Path
) -> None:
    (tmp_path / "fleet.toml").write_text(
        '[fleet]\nout = "out"\nsequences = "asked.toml"\n[[cell]]\nname = "a"\nsources = ["logs"]'
    )
    (tmp_path / "asked.toml").write_text('[[sequence]]\nname = "slip"\nplaces = ["home", "conveyer"]')
    shutil.copytree(small_cell / "dataset", tmp_path / "out" / "a" / "dataset")
    shutil.copytree(small_cell / "model", tmp_path / "out" / "a" / "model")
    (row,) = fleets.run_fleet(fleets.load_fleet(tmp_path / "fleet.toml"), ["report"]).rows
    assert row.state == "failed"
    assert "unknown place 'conveyer'" in row.text
    known = json.loads((tmp_path / "out" / "a" / "cell.json").read_text(encoding="utf-8"))
    assert known["figures"]["executions"] == 6
    assert known["figures"]["model_doubt"]  # trained for two epochs
    assert not (tmp_path / "out" / "a" / "report.html").exists()


def test_a_fault_of_ours_in_one_cell_is_told_as_one(one_day: Path, tmp_path: Path, monkeypatch) -> None:
    def faulty(*_: object) -> None:
        raise KeyError("no such thing")

    (cell,) = fleets.load_fleet(fleet_of(tmp_path, one_day, "a")).cells
    monkeypatch.setitem(fleets.STAGES, "ingest", faulty)
    (row,) = run_stages(cell, stages=["ingest"])
    assert (row.state, row.text) == ("failed", "internal error: KeyError: 'no such thing'")


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "no [[cell]] in it"),
        ('[[cell]]\nname = "a"\n', "no 'sources'"),
        ('[[cell]]\nname = "../a"\nsources = ["x"]', "name = '../a'"),
        ('[[cell]]\nname = "a"\nsources = ["x"]\n[[cell]]\nname = "a"\nsources = ["y"]', "'a' is used twice"),
        ('[[cell]]\nname = "a"\nsources = "x"', "sources = 'x': expected a list, got a text"),
        ('fleet = 1\n[[cell]]\nname = "a"\nsources = ["x"]', "[fleet]: 1 must be a table"),
        ('[[cell]]\nname = "a"\nsources = ["x"]\nepochs = 0', "epochs = 0: expected a whole number >= 1"),
    ],
)
def test_a_fleet_file_that_cannot_be_followed_is_refused(text: str, said: str, tmp_path: Path) -> None:
    (tmp_path / "fleet.toml").write_text(text, encoding="utf-8")
    with pytest.raises(ConfigError) as caught:
        fleets.load_fleet(tmp_path / "fleet.toml")
    assert said in str(caught.value)


@pytest.mark.parametrize("text", ["[flet]\n", "[fleet]\nseads = 1\n", '[[cell]]\nname = "a"\nsourcs = ["x"]'])
def test_a_slip_in_a_key_of_the_fleet_file_is_named(text: str, tmp_path: Path) -> None:
    more = '\n[[cell]]\nname = "b"\nsources = ["y"]'
    (tmp_path / "fleet.toml").write_text(text + more, encoding="utf-8")
    with pytest.raises(UnknownName):
        fleets.load_fleet(tmp_path / "fleet.toml")


def test_sources_are_taken_from_the_folder_of_the_file_and_wildcards_mean_what_is_there(tmp_path: Path) -> None:
    for day in ("01", "02"):
        (tmp_path / "logs" / f"2026-11-{day}").mkdir(parents=True)
    (tmp_path / "fleet.toml").write_text(
        '[[cell]]\nname = "a"\nsources = ["logs/2026-*", "s3://b/x*"]\n[[cell]]\nname = "b"\nsources = ["no*"]'
    )
    wanted: Fleet = fleets.load_fleet(tmp_path / "fleet.toml")
    assert [Path(path).name for path in wanted.cells[0].logs()] == ["2026-11-01", "2026-11-02", "x*"]
    assert Path(wanted.cells[0].dataset) == tmp_path / "fleet" / "a" / "dataset"
    with pytest.raises(ConfigError, match="nothing matches"):
        wanted.cells[1].logs()


@pytest.mark.parametrize(
    ("path", "day"),
    [
        ("logs/2026-11-03/robot.csv", dt.date(2026, 11, 3)),
        ("logs/run_20261103_0815.csv", dt.date(2026, 11, 3)),
        ("2025-01-01/2026_02_03.csv", dt.date(2026, 2, 3)),
        ("logs/2026-13-03/robot.csv", None),
        ("logs/120261103.csv", None),
        ("robot.csv", None),
    ],
)
def test_the_day_of_a_log_stands_in_its_path(path: str, day: dt.date | None) -> None:
    assert day_in(path) == day


def test_else_it_is_when_the_file_was_written(small_cell: Path, tmp_path: Path) -> None:
    logs = shutil.copytree(small_cell / "logs", tmp_path / "logs")
    for file in logs.rglob("*.csv"):
        os.utime(file, (1_790_000_000 + 86_400 * (file.parent.name == "day_1"),) * 2)
    days = days_of(Dataset.open(small_cell / "dataset"), [logs])
    assert days == {"day_0": dt.date(2026, 9, 21), "day_1": dt.date(2026, 9, 22)}


class Blind:
    """A model that sees nothing and has learned from nothing."""

    problem, horizon_s, levels = "now", 0.0, ()
    inputs = ("robot_x_m", "robot_y_m", "robot_z_m", "human_x_m", "human_y_m", "human_z_m")

    def __init__(self, **split: list[str]) -> None:
        self.card = TrainingCard(split=SplitCard(**{part: tuple(names) for part, names in split.items()}))

    def predict(self, positions):
        return 0 * positions[:, 0]


def test_the_last_month_is_held_against_the_time_before(small_cell: Path) -> None:
    logs = Dataset.open(small_cell / "dataset")
    apart = {"day_0": dt.date(2026, 9, 21), "day_1": dt.date(2026, 11, 1)}
    found = since_last_month(Blind(), logs, apart)
    assert not isinstance(found, str)
    assert found.executions == (3, 3)
    learned = Blind(train=["day_0.001", "day_0.002"])
    for days, said in (
        ({}, "the days of the logs are not known"),
        ({"day_0": dt.date(2026, 10, 21), "day_1": dt.date(2026, 11, 1)}, "less than a month"),
    ):
        assert said in str(since_last_month(Blind(), logs, days))
    assert "too few" in str(since_last_month(learned, logs, apart))
    after = since_training(Blind(test=["day_0.001", "day_0.002"], train=["day_0.003"]), logs)
    assert after is not None
    assert after.executions == (2, 3)


FIGURES = FiguresCard(
    executions=20, cycle_s=90.0, lost_s=9.0, lost_share=0.1, newest=dt.date(2026, 11, 20), set_aside_share=0.0,
    safety_changed=False, habits_changed=False,
)  # fmt: skip


def test_the_page_ranks_cells_and_names_those_that_need_a_look() -> None:
    cells = [
        CellLine("good", FIGURES, link="good/report.html"),
        CellLine("worst", replace(FIGURES, lost_share=0.5), link="worst/report.html"),
        CellLine("old", replace(FIGURES, newest=dt.date(2026, 11, 1))),
        CellLine("dirty", replace(FIGURES, set_aside_share=0.02), unread="a.csv: cut"),
        CellLine("moved", replace(FIGURES, safety_changed=True, shifts=("everywhere: 0.010 -> 0.090",))),
        CellLine("unlearned", replace(FIGURES, model_doubt="mean absolute error 0.148")),
        CellLine(
            "<b>", FiguresCard(), failed=["ingest: no such folder\n  Check the path.", "train: no logs\nAdd some"]
        ),
        CellLine("lit", replace(FIGURES, light="red", light_why=("the clocks are assumed", "the pose is not given"))),
        CellLine("dim", replace(FIGURES, light="amber", light_why=("few executions",))),
        CellLine("sound", replace(FIGURES, light="green")),
    ]
    page = fleet_page("Line 4", cells, TODAY)
    order = [page.index(f">{name}<", page.index("<tbody>")) for name in ("worst", "dirty", "good", "&lt;b&gt;")]
    assert page.count('<td class="date" data-head="Newest log">') == len(cells)  # a date stays on one line
    assert order == sorted(order)
    look = page[page.index('id="look"') : page.index('id="cells"')]
    assert "worst loses most to safety: 50" in look
    assert "7 cells need a look" in look
    for said in (
        "20 days old",
        "of the rows were set aside",
        "Logs not read: a.csv: cut",
        "0.010 -&gt; 0.090",
        "Failed in ingest: no such folder. Check the path. Failed in train: no logs. Add some.",
        "Red, its report cannot be trusted: the clocks are assumed; the pose is not given.",
        "Amber, read its report with these limits: few executions.",
        "The error of the model is large: mean absolute error 0.148.",
    ):
        assert said in look
    assert "good/report.html" not in look
    assert re.findall(r'<span class="lamp (\w+)">(\w+)</span>', page) == [
        (one, one) for one in ("amber", "red", "green")
    ]
    assert "://" not in page
