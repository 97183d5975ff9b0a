"""Sheets of Excel workbooks: numbers as they are, rows by the numbers of the sheet, and none that fills the memory."""

import sys
import zipfile
from datetime import datetime, timedelta

import pytest
from hypothesis import given
from hypothesis import strategies as st
from sheet_files import frame_of, sheet_xml, write_parts, write_workbook

from cyclekit.adapter import ReadOptions
from cyclekit.errors import ConfigError, DamagedLog, LogError, MissingColumns, MissingExtra, UnknownName
from cyclekit_adapters.formats.mapped_csv import ADAPTER

NAMES = ["t", "x", "y"]
PLACE = {"time": "t", "x": "x", "y": "y"}


def read(path, **mapping):
    return ADAPTER.read(path, ReadOptions(role="robot", map=PLACE | mapping))


def test_numbers_are_those_of_the_sheet_to_the_last_digit(tmp_path):
    path = write_workbook(tmp_path / "a.xlsx", {"S": [NAMES, [0.1, 0.30000000000000004, 1e-12], [0.2, -5, 1e22]]})
    log = read(path)
    assert log.robot.select("t_s", "tcp_x_m", "tcp_y_m").rows() == [
        (0.1, 0.30000000000000004, 1e-12),
        (0.2, -5.0, 1e22),
    ]
    assert log.facts["sheet"] == "S"
    assert not ADAPTER.recognises(path)


@given(st.lists(st.floats(allow_nan=False, allow_infinity=False), min_size=1, max_size=6))
def test_every_number_comes_back(tmp_path_factory, values):
    path = tmp_path_factory.mktemp("sheet") / "a.xlsx"
    write_workbook(path, {"S": [NAMES, *([i, value, 1] for i, value in enumerate(values))]})
    assert read(path).robot["tcp_x_m"].to_list() == values


def test_rows_are_counted_as_the_spreadsheet_counts_them(tmp_path):
    rows = [["made by"], [], NAMES, [0.1, 1, 2], [], [0.2, "oops", 2], [0.3, None, None], [0.4, "1.5", 2], [None, 1, 2]]
    log = read(write_workbook(tmp_path / "a.xlsx", {"S": rows}), skip_rows=2)
    assert log.robot.select("t_s", "tcp_x_m", "source_row").rows() == [(0.1, 1, 4), (0.4, 1.5, 8)]
    assert log.set_aside["source_row"].to_list() == [6, 7, 9]
    assert "'oops' in column 'x' is not a number" in log.set_aside["reason"][0]
    assert log.rows_are == "row"


def test_a_sheet_that_begins_lower_and_farther_right(tmp_path):
    path = write_workbook(tmp_path / "a.xlsx", {"S": [[None, *NAMES], [None, 0.1, 1, 2]]}, first_row=4)
    assert read(path, skip_rows=3).robot["source_row"].to_list() == [5]
    assert read(path, skip_rows=3, x="#3", y="#4").robot["tcp_x_m"].to_list() == [1]


def test_the_first_sheet_with_a_table_or_the_one_that_is_named(tmp_path):
    sheets = {"Info": [["made by me"]], "Run 1": [NAMES, [0, 1, 2]], "Run 2": [NAMES, [0, 3, 4]]}
    path = write_workbook(tmp_path / "a.xlsx", sheets)
    assert read(path).robot["tcp_x_m"].to_list() == [1]
    assert read(path, sheet="Run 2").robot["tcp_x_m"].to_list() == [3]
    with pytest.raises(UnknownName, match="Run 3"):
        read(path, sheet="Run 3")
    with pytest.raises(DamagedLog, match="holds no table"):
        read(path, sheet="Info")
    with pytest.raises(MissingColumns) as refusal:
        read(path, y="z")
    assert "Sheets: Info, Run 1, Run 2" in str(refusal.value)
    (tmp_path / "a.csv").write_text("t,x,y\n0,1,2\n")
    with pytest.raises(ConfigError, match="the log is a text"):
        read(tmp_path / "a.csv", sheet="Run 1")


def test_dates_in_cells_are_times(tmp_path):
    begin = datetime(2024, 5, 1, 10)
    rows = [[begin + timedelta(milliseconds=250 * i), i, 2] for i in range(4)]
    path = write_workbook(tmp_path / "a.xlsx", {"S": [NAMES, *rows]})
    log = read(path, time_format="iso", time_zone="UTC")
    assert log.robot["t_s"].to_list() == pytest.approx([1714557600 + 0.25 * i for i in range(4)], abs=1e-3)
    assert log.clock == "epoch"
    assert {p.key: p.value for p in ADAPTER.draft(path).map}["time_format"] == "iso"


def test_a_draft_of_a_workbook_reads_it_as_it_is(tmp_path):
    names = ["Time [s]", "TCP X [mm]", "TCP Y [mm]", "Speed override", "State"]
    rows = [[0.024 * i, 500.25 + i, -250.5, 50 * (1 + i % 2), "Running"] for i in range(40)]
    path = write_workbook(tmp_path / "rs.xlsx", {"Info": [["RobotStudio"]], "Data": [["Station"], [], names, *rows]})
    draft = ADAPTER.draft(path)
    assert draft.unsure == 0
    log = ADAPTER.read(path, ReadOptions(role="robot", map={p.key: p.value for p in draft.map}))
    assert log.robot["tcp_x_m"].to_list() == pytest.approx([(500.25 + i) / 1000 for i in range(40)])
    assert log.robot["scaling"].to_list()[:2] == [0.5, 1.0]


def test_a_missing_reader_is_named_with_the_command_that_adds_it(tmp_path, monkeypatch):
    path = write_workbook(tmp_path / "a.xlsx", {"S": [NAMES, [0, 1, 2]]})
    monkeypatch.setitem(sys.modules, "fastexcel", None)
    with pytest.raises(MissingExtra, match=r'pip install "cyclekit\[excel\]"'):
        read(path)


def refused(path):
    with pytest.raises(LogError) as refusal:
        read(path)
    return str(refusal.value)


def parts(rows, texts=()):
    shared = {text: at for at, text in enumerate(texts)}
    items = "".join(f"<si><t>{text}</t></si>" for text in (*texts, *NAMES))
    body = sheet_xml([NAMES, *rows], dict(shared))
    return {**frame_of(["S"]), "xl/sharedStrings.xml": f"<sst>{items}</sst>", "xl/worksheets/sheet1.xml": body}


def test_a_cell_far_below_does_not_fill_the_memory(tmp_path):
    made = parts([[0, 1, 2]])
    far = '<row r="1048576"><c r="XFD1048576"><v>1</v></c></row></sheetData>'
    made["xl/worksheets/sheet1.xml"] = made["xl/worksheets/sheet1.xml"].replace("</sheetData>", far)
    assert "too large" in refused(write_parts(tmp_path / "a.xlsx", made))
    nameless = far.replace(' r="XFD1048576"', "")
    made = parts([[0] * 5])
    made["xl/worksheets/sheet1.xml"] = made["xl/worksheets/sheet1.xml"].replace("</sheetData>", nameless)
    assert "too large" in refused(write_parts(tmp_path / "b.xlsx", made))


def test_one_long_text_that_many_cells_mean_does_not_fill_the_memory(tmp_path):
    text = "a" * 30_000
    made = parts([[0, 1, 2, *[text] * 20] for _ in range(600)], texts=[text])
    assert "texts are longer" in refused(write_parts(tmp_path / "a.xlsx", made))


def test_a_workbook_that_unpacks_to_far_more_than_it_is_long_is_refused(tmp_path):
    made = parts([[0, 1, 2]])
    made["xl/worksheets/sheet1.xml"] += " " * 50_000_000
    assert "unpacks to more than 200 times" in refused(write_parts(tmp_path / "a.xlsx", made))


def test_a_tag_without_an_end_is_refused(tmp_path):
    import random

    made = parts([[0, 1, 2]])
    noise = "".join(random.Random(1).choices("abcdefgh", k=3_000_000))
    made["xl/worksheets/sheet1.xml"] += f"<c {noise}"
    assert "1 MiB" in refused(write_parts(tmp_path / "a.xlsx", made))


@given(cut=st.floats(0.02, 0.98), flipped=st.floats(0.0, 0.999))
def test_a_damaged_workbook_is_one_message_or_its_rows(tmp_path_factory, cut, flipped):
    folder = tmp_path_factory.mktemp("damaged")
    whole = write_workbook(folder / "a.xlsx", {"S": [NAMES, *([i, i / 7, 1] for i in range(50))]}).read_bytes()
    (folder / "cut.xlsx").write_bytes(whole[: int(cut * len(whole))])
    assert refused(folder / "cut.xlsx")
    bad = bytearray(whole)
    bad[int(flipped * len(bad))] ^= 0x55
    (folder / "bad.xlsx").write_bytes(bad)
    try:
        log = read(folder / "bad.xlsx")
    except LogError:
        return
    assert log.robot["tcp_x_m"].to_list() == [i / 7 for i in range(50)]


def test_what_is_not_part_of_the_sheets_is_left_alone(tmp_path):
    path = write_workbook(tmp_path / "a.xlsx", {"S": [NAMES, [0, 1, 2]]})
    with zipfile.ZipFile(path, "a", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("xl/media/image1.png", b"\0" * 60_000_000)
    assert read(path).robot["tcp_x_m"].to_list() == [1]
