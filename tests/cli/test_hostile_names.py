"""Whatever files, places and executions are called, the terminal, the page and a spreadsheet are not steered by it."""

from __future__ import annotations

import csv
import io
import json
import sys
import unicodedata
from pathlib import Path

import polars as pl
import pytest
from examples import at_most
from fabricated import fabricate_dataset
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from cyclekit.cli import run
from cyclekit.cli.terminal import Terminal, _Lines, bullet, say_failure, table, write_json
from cyclekit.dataset.dataset import Dataset
from cyclekit.ingest.convert import convert

BIDI = "\u061c\u200e\u200f\u202a\u202b\u202c\u202d\u202e\u2066\u2067\u2068\u2069"
NASTY = {
    "conveyor": "\x1b]0;owned\x07\x1b[2J",
    "left": "=cmd|' /C calc'!A0",
    "right": "[click](javascript:alert(1))<script>alert(1)</script>",
    "home": "a\nerror: forged\u202egnp.exe\x9b31m",
}


def steers(text: str) -> set[str]:
    return {c for c in text if c != "\n" and (unicodedata.category(c) in ("Cc", "Zl", "Zp") or c in BIDI)}


def renamed(folder: Path, names: dict[str, str]) -> None:
    """Give the places of a dataset other names, in its card and its tables."""
    card = folder / "dataset.json"
    known = json.loads(card.read_text(encoding="utf-8"))
    for kind in ("places", "human_places"):
        known[kind] = {names.get(name, name): entry for name, entry in known[kind].items()}
    known["name"], known["warnings"] = names["home"], [*names.values()]
    card.write_text(json.dumps(known), encoding="utf-8")
    for file in [folder / "tasks.parquet", *(folder / "samples").glob("*.parquet")]:
        frame = pl.read_parquet(file)
        texts = [name for name in ("task", "start_place", "goal_place", "robot_task", "human_task") if name in frame]
        for old, new in names.items():
            frame = frame.with_columns(pl.col(texts).str.replace_all(old, new, literal=True))
        frame.write_parquet(file)


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("nasty") / "dataset"
    fabricate_dataset(folder, executions=2, rounds=1)
    renamed(folder, NASTY)
    return folder


@pytest.mark.parametrize("words", [["inspect"], ["levels"], ["inspect", "--json"]])
def test_what_a_command_shows_of_a_hostile_dataset_steers_no_terminal(
    words: list[str], dataset: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run([words[0], str(dataset), *words[1:]]) == 0
    said = capsys.readouterr()
    assert not steers(said.out + said.err)
    assert not [line for line in (said.out + said.err).splitlines() if line.startswith("error: forged")]


def test_every_text_out_of_a_hostile_table_is_one_line(dataset: Path) -> None:
    opened = Dataset.open(dataset)
    record = opened.recordings[0].id
    file = dataset / "recordings" / record / "people.parquet"
    pl.read_parquet(file).with_columns(person=pl.lit(NASTY["home"])).write_parquet(file)
    execution = opened.executions["execution"][0]
    tables = [opened.tasks(), opened.done_tasks(), opened.samples(), opened.samples([execution])]
    tables += [opened.recorded(record, "people"), opened.recorded_between(record, "people", 0, 9)]
    texts = {text for table in tables for column in table.select(pl.col(pl.String)) for text in column.drop_nulls()}
    assert "a\\nerror: forged\\u202egnp.exe\\x9b31m" in texts
    assert not {text for text in texts if steers(text) or "\n" in text}


@pytest.mark.slow
def test_reports_and_replay_of_a_hostile_dataset_are_shown_and_not_obeyed(dataset: Path, tmp_path: Path) -> None:
    from rerun.chunk import RrdReader

    for name in ("r.md", "r.csv", "r.html"):
        assert run(["report", str(dataset), "--out", str(tmp_path / name), "--quiet"]) == 0
    texts = {file.suffix: file.read_text(encoding="utf-8") for file in tmp_path.iterdir()}
    assert not {suffix: steers(text) for suffix, text in texts.items() if steers(text)}
    assert "<script>" not in texts[".md"]
    assert "](javascript" not in texts[".md"]
    assert "<script>alert" not in texts[".html"]
    assert "alert(1)" in texts[".html"]
    cells = [cell for row in csv.reader(io.StringIO(texts[".csv"])) for cell in row]
    assert any(cell.startswith("'=cmd|") for cell in cells)
    assert not [cell for cell in cells if cell.startswith(("=", "@"))]
    rrd = tmp_path / "r.rrd"
    assert run(["replay", str(dataset), "--execution", "1", "--execution", "2", "--out", str(rrd), "--quiet"]) == 0
    shown = " ".join(
        str(chunk.to_record_batch().to_pydict())
        for chunk in RrdReader(rrd).stream()
        if str(chunk.entity_path).split("/")[-1] in ("summary", "comparison")
    )
    assert "alert" in shown
    assert "](javascript" not in shown
    assert "<script" not in shown


@pytest.mark.skipif(sys.platform == "win32", reason="such a name is no name there")
def test_a_log_with_a_hostile_name_steers_no_terminal(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    logs = tmp_path / "logs"
    logs.mkdir()
    x = [0.3 * (number // 20 % 2) for number in range(200)]
    rows = ["time,x,y,z", *(f"{0.05 * row:.2f},{at},0.0,0.4" for row, at in enumerate(x)), "garbled,row,1,2"]
    (logs / "r\x1b[2J\nerror: forged\u202e.csv").write_text("\n".join(rows), encoding="utf-8")
    (logs / "n\x1b[2J\nerror: forged\u202e.txt").write_text("no log", encoding="utf-8")
    (logs / "cell.toml").write_text(
        '[[sources]]\npath = "r*.csv"\nadapter = "csv"\nrole = "robot"\n'
        'map = { time = "time", x = "x", y = "y", z = "z" }\n'
        '[places."p\\u001b[2J\\nerror: forged"]\nxyz_m = [0.3, 0.0, 0.0]\n',
        encoding="utf-8",
    )
    data, page = str(tmp_path / "d"), str(tmp_path / "r.html")
    for words in (["inspect", str(logs)], ["ingest", str(logs), "--out", data], ["inspect", data], ["levels", data]):
        run(words)
        said = capsys.readouterr()
        assert not steers(said.out + said.err), words
        assert not [line for line in (said.out + said.err).splitlines() if line.startswith("error: forged")], words
    assert run(["report", data, "--out", page]) == 0
    for file in logs.iterdir():
        run(["inspect", str(file)])
        run(["ingest", str(file / "none"), "--out", data])
        said = capsys.readouterr()
        assert not steers(said.out + said.err)
        assert not [line for line in (said.out + said.err).splitlines() if line.startswith("error: forged")]


def test_events_that_are_formulas_become_text_in_a_converted_table_and_numbers_stay(tmp_path: Path) -> None:
    log, out = tmp_path / "events.csv", tmp_path / "out.csv"
    log.write_text('time_s,signal,value\n0.0,@SUM(A1),=1+1\n0.5,speed,-4.5\n1.0,esc,"a\x1bb"\n', encoding="utf-8")
    convert(log, out)
    rows = list(csv.DictReader(io.StringIO(out.read_text(encoding="utf-8"))))
    assert [row["signal"] for row in rows] == ["'@SUM(A1)", "speed", "esc"]
    assert [row["value"] for row in rows] == ["'=1+1", "-4.5", r"a\x1bb"]


NAMES = st.text(st.one_of(st.characters(max_codepoint=0xA0), st.sampled_from(BIDI), st.characters()), max_size=30)


@given(name=NAMES)
@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_no_way_to_the_terminal_lets_a_control_through(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    capsys.readouterr()
    terminal = Terminal(json=False, quiet=False)
    terminal.remark(name)
    terminal.warnings([name])
    terminal.done({}, f"{name}: done")
    terminal.answer({}, table(["name ", "s"], [[name, "1"]]), bullet([name]))
    with terminal.progress(name) as progress:
        progress(0.5, name)
    lines = _Lines("reading")
    lines.forecast.began_s -= 100
    lines(0.5, name)
    write_json({name: [name]})
    say_failure(name, kind="x", as_json=True)
    said = capsys.readouterr()
    assert not steers((said.out + said.err).replace("\t", ""))


@given(NAMES)
def test_a_name_in_a_table_is_one_row(name: str) -> None:
    assert len(table(["name ", "s"], [[name[:10], "1"], ["b", "2"]]).splitlines()) <= 5


@given(name=NAMES)
@at_most(30, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_no_argument_comes_back_as_a_control(
    name: str, capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)  # no name is that of the repository, which is long to look through
    capsys.readouterr()
    name = name.replace("\0", "").encode("utf-8", "ignore").decode()  # no process can be given the others
    run(["inspect", name])
    run(["levels", f"--{name}"])
    said = capsys.readouterr()
    assert not steers((said.out + said.err).replace("\t", ""))
