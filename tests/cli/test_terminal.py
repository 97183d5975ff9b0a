"""What a person sees: tables in 80 columns, durations as people say them, few lines where nothing can be redrawn."""

from __future__ import annotations

import contextlib
import dataclasses
import json
import math
import re
import time
from collections import Counter
from pathlib import Path
from unittest import mock

import pytest
import typer
from fabricated import fabricate_dataset
from hypothesis import given
from hypothesis import strategies as st
from rich.cells import cell_len

from cyclekit.cli import terminal
from cyclekit.cli.facts import page
from cyclekit.cli.options import seconds, vector
from cyclekit.cli.terminal import Terminal, bullet, columns, table, write_json, write_out
from cyclekit.inspect.describe import describe
from cyclekit.inspect.facts import DatasetDescription
from cyclekit.text.numbers import percent, signed_percent
from cyclekit.text.plain_text import one_line


def test_a_path_in_brackets_stays_in_the_table() -> None:
    shown = table(["log ", "rows"], [["run[a].csv", "12"], ["[bold]x[/bold]", "3"]])
    assert "run[a].csv" in shown
    assert "[bold]x[/bold]" in shown


def test_a_long_name_is_folded_and_no_number_is_lost() -> None:
    shown = table(["name ", "s", "s2"], [["x" * 300, "123.4", "5678.9"]])
    assert max(map(len, shown.splitlines())) <= 80
    assert "123.4" in shown
    assert "5678.9" in shown


@st.composite
def tables(draw: st.DrawFn) -> tuple[list[str], list[list[str]]]:
    """Draw any table: up to eight columns of text or numbers, and up to four rows of cells of any length."""
    count = draw(st.integers(1, 8))
    cells = st.one_of(st.text(max_size=8), st.integers(0, 90).map("x".__mul__), st.sampled_from(["12.5 s", "wait for"]))
    header = draw(st.lists(cells, min_size=count, max_size=count))
    header = [name + " " * draw(st.booleans()) for name in header]
    return header, draw(st.lists(st.lists(cells, min_size=count, max_size=count), max_size=4))


@given(tables(), st.integers(1, 200))
def test_a_table_of_any_text_at_any_width_is_shown_and_loses_nothing(drawn, width: int) -> None:
    header, rows = drawn
    with mock.patch.dict("os.environ", {"COLUMNS": str(width)}):
        shown = table(header, rows)
        assert max(map(cell_len, shown.split("\n"))) <= 2 * columns()  # letters of two columns are wrapped by number
        if shown.isascii():
            assert max(map(len, shown.split("\n"))) <= columns()
    left = Counter(shown)
    left.subtract(c for row in rows for c in "".join(map(one_line, row)) if not c.isspace())
    lost = {c for c, count in left.items() if count < 0}
    assert not lost


def test_a_long_wait_beside_numbers_is_a_table() -> None:
    for length in range(45, 90):
        row = ["pick", "w" * length, "n" * 12, "9" * length]
        assert table(["task ", "waits for ", "s", "of"], [row]).count("w") >= length
        assert table(["task", "waits for", "s"], [["pick", "w" * length, "9" * 6]]).count("w") >= length


def test_numbers_have_signs_that_every_terminal_has(capsys: pytest.CaptureFixture[str]) -> None:
    Terminal(json=False, quiet=False).answer({}, f"{signed_percent(-0.09)} of {percent(0.5)}")
    assert capsys.readouterr().out == "-9 % of 50 %\n"


def test_what_is_not_a_number_is_null_in_json(capsys: pytest.CaptureFixture[str]) -> None:
    write_json({"a": math.nan, "b": [1.0, math.inf], "path": Path("x")})
    assert json.loads(capsys.readouterr().out) == {"a": None, "b": [1.0, None], "path": "x"}


def test_a_remark_keeps_to_80_columns() -> None:
    assert max(map(len, bullet(["word " * 60]).splitlines())) <= 80


def test_no_word_is_cut_at_the_edge_of_a_terminal(capsys, monkeypatch) -> None:
    monkeypatch.setenv("COLUMNS", "40")
    command = "next: cyclekit estimate a_long_name_of_a_model s.toml --dataset data"
    text = f"a table  1  2\n  - one sentence that is longer than the terminal has columns\n{command}"
    monkeypatch.setattr("sys.stdout.isatty", lambda: True)
    Terminal(json=False, quiet=False).answer({}, text)
    lines = capsys.readouterr().out.splitlines()
    assert lines == ["a table  1  2", "  - one sentence that is longer than the", "    terminal has columns", command]


def test_what_a_program_reads_is_not_broken_into_lines(capsys, monkeypatch) -> None:
    monkeypatch.setenv("COLUMNS", "40")
    monkeypatch.setattr("sys.stdout.isatty", lambda: True)
    Terminal(json=True, quiet=False).answer({"text": "long words " * 9}, "")
    assert json.loads(capsys.readouterr().out)["text"] == "long words " * 9
    monkeypatch.setattr("sys.stdout.isatty", lambda: False)
    Terminal(json=False, quiet=False).answer({}, "long words " * 9)
    assert len(capsys.readouterr().out.splitlines()) == 1


@given(st.floats(min_value=0.001, max_value=1e5))
def test_a_duration_typed_with_any_unit_means_the_same(value: float) -> None:
    assert seconds(f"{value!r}s") == seconds(f"{value!r}") == value
    assert seconds(f"{value!r} min") == pytest.approx(60 * value)
    assert seconds(f"{value!r}ms") == pytest.approx(value / 1000)


@given(st.text(max_size=12))
def test_a_duration_that_is_none_is_a_usage_error_never_a_crash(text: str) -> None:
    with contextlib.suppress(typer.BadParameter):
        assert 0 < seconds(text) < math.inf


@given(st.text(alphabet="0123456789.,-+einf ", max_size=20))
def test_a_position_is_three_finite_numbers_or_a_usage_error(text: str) -> None:
    with contextlib.suppress(typer.BadParameter):
        assert all(math.isfinite(value) for value in vector(text))


def test_progress_is_silent_with_quiet_and_when_the_work_is_short(capsys: pytest.CaptureFixture[str]) -> None:
    for quiet in (True, False):
        with Terminal(json=False, quiet=quiet).progress("working") as progress:
            progress(0.5, "half")
    assert capsys.readouterr() == ("", "")


def test_progress_is_few_lines_where_nothing_can_be_redrawn(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    now_s = [0.0]
    monkeypatch.setattr(time, "monotonic", lambda: now_s[0])
    with Terminal(json=False, quiet=False).progress("working") as progress:
        for _ in range(1000):
            now_s[0] += 0.1
            progress(now_s[0] / 100, "log 3")
    out, err = capsys.readouterr()
    lines = err.splitlines()
    assert out == ""
    assert 5 <= len(lines) <= 8  # after 2, 4, 8 ... 64 s of 100
    assert lines[0].startswith("working: 2.0 % after 2.0 s  log 3")  # too little to go by
    assert "after 16 s, about 84 s left" in lines[3]


def test_a_step_that_takes_long_promises_no_longer_time(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    now_s = [0.0]
    monkeypatch.setattr(time, "monotonic", lambda: now_s[0])
    with Terminal(json=False, quiet=False).progress("working") as progress:
        now_s[0] = 10.0
        progress(0.1, "read")  # 90 s are left
        for now_s[0] in (40.0, 160.0):
            progress(0.1, "")
    assert [line.split(", ")[-1].strip() for line in capsys.readouterr().err.splitlines()] == [
        "about 90 s left  read",
        "about 60 s left",
        "working: 10 % after 2 min 40 s",
    ]


def test_progress_in_a_terminal_shows_rate_and_time_left(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(terminal.sys.stderr, "isatty", lambda: True, raising=False)
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("COLUMNS", "80")
    with Terminal(json=False, quiet=False).progress("working") as progress:
        progress(0.25, "log[3]")
        time.sleep(0.3)  # the bar is drawn ten times a second
    out, err = capsys.readouterr()
    assert out == ""
    drawn = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", err)
    assert "25%" in drawn
    assert "%/s" in drawn
    assert "log[3]" in drawn
    assert max(len(line) for line in re.split(r"[\r\n]", drawn)) <= 80


def test_work_that_says_nothing_is_still_seen_to_go_on(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(terminal, "PATIENCE_S", 0.05)
    begin, err, limit_s = time.monotonic(), "", time.monotonic() + 60.0
    with Terminal(json=False, quiet=False).progress("evaluating"):
        while err.count("\n") < 2 and time.monotonic() < limit_s:
            time.sleep(0.02)
            err += capsys.readouterr().err
    took_s = time.monotonic() - begin
    out, rest = capsys.readouterr()
    lines = (err + rest).splitlines()
    assert out == ""
    assert all(re.match(r"evaluating: \d", line) for line in lines)
    assert 2 <= len(lines) <= 2 + math.log2(took_s / 0.05)  # after 0.05, 0.1, 0.2, 0.4 ... s


def test_a_result_is_written_whole_with_its_folder(tmp_path: Path) -> None:
    write_out(tmp_path / "new" / "x.json", {"expected_s": math.nan})
    assert json.loads((tmp_path / "new" / "x.json").read_text(encoding="utf-8")) == {"expected_s": None}
    assert [path.name for path in (tmp_path / "new").iterdir()] == ["x.json"]


def test_an_inspected_dataset_keeps_to_80_columns_however_many_reasons_it_has(tmp_path: Path) -> None:
    found = describe(fabricate_dataset(tmp_path / "dataset", executions=1, rounds=1).path)
    assert isinstance(found, DatasetDescription)
    reasons = {f"some reason why it is unknown {number}": 1000 + number for number in range(4)}
    shown = page(dataclasses.replace(found, path=Path("dataset"), scaling_gaps=reasons))
    assert all(str(count) in shown for count in reasons.values())
    assert max(map(len, shown.splitlines())) <= 80


@pytest.mark.parametrize("width", [60, 80])
def test_a_table_fits_the_terminal_and_breaks_no_word_of_a_name(width: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", str(width))
    heads = ["change ", "sequence ", "before, s", "after, s", "mean (95%)", "saves, s"]
    row = ["conveyor back", "right table first", "102.7*", "102.2*", "99.1-105.7", "10.4 (10.2 to 10.7)"]
    lines = table(heads, [row, row]).splitlines()
    assert max(map(len, lines)) <= width
    words = {word.strip(",") for line in lines for word in line.split()}
    assert {"conveyor", "right", "table", "first", "102.7*", "99.1-105.7", "10.7)"} <= words
    if width == 60:
        assert lines.count("conveyor back, sequence: right table first") == 2
