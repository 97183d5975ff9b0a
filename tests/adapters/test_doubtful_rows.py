"""Rows that could be read otherwise than they were meant are not read: each case was once a wrong value."""

import tempfile
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cyclekit.adapter import ReadOptions
from cyclekit.errors import DamagedLog, MissingColumns
from cyclekit_adapters.formats import mapped_csv, ur_rtde
from cyclekit_adapters.text.delimited import INDEX, TextLayout, read_rows
from cyclekit_adapters.text.header_line import MAX_COLUMNS, layout_below

COMMA = TextLayout(("t", "x", "y"), ",", header_lines=1)
BLANK = replace(COMMA, delimiter=" ")
QUOTED = replace(COMMA, quotes=True)


def rows_of(text, layout=COMMA, **columns):
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "log.csv"
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        return read_rows(path, layout, **(columns or {"numbers": ["t", "x", "y"]}))


def values(rows):
    return rows.frame.drop(INDEX, "source_row").rows()


def aside(rows):
    return rows.set_aside["source_row"].to_list()


def mapped(path, text, role="people", **mapping):
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return mapped_csv.ADAPTER.read(path, ReadOptions(role=role, map={"time": "t", "x": "x", "y": "y"} | mapping))


def test_two_blanks_in_a_row_of_the_right_length_are_a_field_that_moved():
    rows = rows_of("t x y\n1 2 3\n4  5\n 6 7\n8 9 10 \n", BLANK)
    assert values(rows) == [(1, 2, 3), (8, 9, 10)]
    assert aside(rows) == [3, 4]


def test_a_moved_field_is_noticed_also_where_the_columns_beside_it_are_not_read():
    rows = rows_of(
        "a t x b\n0 1 2 9\n 0 1 2\n0  1 2\n0 3 4 9\n", TextLayout(("a", "t", "x", "b"), " ", 1), numbers=["t", "x"]
    )
    assert values(rows) == [(1, 2), (3, 4)]
    assert aside(rows) == [3, 4]
    rows = rows_of("a t x b\n0 1 2 9\n 0 1 2\n", TextLayout(("a", "t", "x", "b"), " ", 1), numbers=["t", "x"])
    assert aside(rows) == [3]


def test_a_row_torn_inside_its_first_number_makes_the_rest_of_it_doubtful():
    rows = rows_of("t,x,y\n1,2,3\n40\n0,5,6\n7,8,9\n")
    assert values(rows) == [(7, 8, 9)]
    assert aside(rows) == [2, 3, 4]  # 40 may be the begin of 400,5,6 or the end of 1,2,340


def test_log_text_between_rows_makes_nothing_doubtful():
    rows = rows_of("t,x,y\n1,2,3\n[WARN] packet lost\n4,5,6\n")
    assert values(rows) == [(1, 2, 3), (4, 5, 6)]


def test_a_row_with_nul_bytes_is_no_row_even_where_they_stand_in_a_text():
    rows = rows_of("t,x,y\n1,an\0\0,3\n4,bo,6\n", numbers=["t"], texts=["x"])
    assert values(rows) == [(4, "bo")]


def test_a_text_that_is_not_written_in_the_encoding_is_set_aside_with_the_cure():
    garbled = "t,x,y\n1,Jörg,3\n4,bo,6\n".encode("latin-1") + "7,Bjørn,8\n".encode()
    rows = rows_of(garbled, numbers=["t"], texts=["x"])
    assert values(rows) == [(4, "bo"), (7, "Bjørn")]
    assert "is not written in utf-8: see `encoding`" in rows.set_aside["reason"][0]
    assert values(rows_of("t,x,y\n1,2,ö\n".encode("latin-1"), numbers=["t", "x"])) == [(1, 2)]


@pytest.mark.parametrize("second", ["s,m,m", "[s],[mm],[deg]", "seconds,metres,-"])
def test_a_row_of_units_below_the_names_is_no_other_table(second):
    rows = rows_of(f"t,x,y\n{second}\n1,2,3\n")
    assert values(rows) == [(1, 2, 3)]
    assert aside(rows) == [2]


@pytest.mark.parametrize("names", ["Time,Force,Force", "Time,,Force", "t,Force,Torque"])
def test_another_table_ends_the_first_also_where_its_names_repeat_or_are_missing(names):
    rows = rows_of(f"t,x,y\n1,2,3\n{names}\n4,5,6\n")
    assert values(rows) == [(1, 2, 3)]
    assert "another table begins in line 3" in rows.set_aside["reason"][1]


@pytest.mark.parametrize(
    ("names", "row", "last"),
    [
        ("y,x,t", "6,5,4", (4, 5, 6)),
        ("t,force,x,y", "4,9,5,6", (4, 5, 6)),
        ("t,y", "4,6", (4, None, 6)),
        ("t,y,x,", "4,6,5,", (4, 5, 6)),
    ],
)
@pytest.mark.parametrize("above", [1, 20_000])
def test_another_header_holds_for_the_rows_below_it(names, row, last, above):
    lines = ["t,x,y", *["1,2,3"] * above, names, *[row] * above, "t,x,y", "7,8,9", ""]
    rows = rows_of("\n".join(lines), numbers=["t", "x", "y"], required=["t"])
    assert values(rows) == [(1, 2, 3)] * above + [last] * above + [(7, 8, 9)]
    said = "another header: the rows below it are read by it"
    assert rows.set_aside.rows()[0] == (above + 2, said + (", without x" if last[1] is None else ""))
    assert aside(rows) == [above + 2, 2 * above + 3]


def test_below_the_names_once_more_the_first_table_goes_on():
    rows = rows_of("t,x,y\n1,2,3\nForce,Torque,Sum\n4,5,6\n\ufefft,x,y\ns,m,m\n7,8,9\n")
    assert values(rows) == [(1, 2, 3), (7, 8, 9)]


def test_the_same_word_in_every_cell_is_a_garbled_row_and_no_table():
    assert values(rows_of("t,x,y\n1,2,3\nWARN,WARN,WARN\n4,5,6\n")) == [(1, 2, 3), (4, 5, 6)]


@pytest.mark.parametrize(
    "cell", ['"the \\"upper\\""', '"upper"left', '"upper', 'a 5" pipe', 'upper"', '"a" "b"', '""upper""']
)
def test_a_quote_that_closes_nowhere_or_inside_its_cell_costs_its_row(cell):
    rows = rows_of(f"t,x,y\n1,{cell},3\n4,bo,6\n", QUOTED, numbers=["t", "y"], texts=["x"])
    assert values(rows) == [(4, 6, "bo")]
    assert aside(rows) == [2]


@pytest.mark.parametrize(
    ("cell", "text"),
    [
        ('"the ""upper"""', 'the "upper"'),
        ('"a, b"', "a, b"),
        ("'ann'", "ann"),
        (' "ann" ', "ann"),
        ("o'neil", "o'neil"),
    ],
)
def test_quotes_are_taken_off_and_nothing_else(cell, text):
    assert values(rows_of(f"t,x,y\n1,{cell},3\n", QUOTED, numbers=["t"], texts=["x"])) == [(1, text)]


def test_with_a_decimal_comma_a_point_makes_no_number():
    layout = TextLayout(("t", "x", "when"), ";", 1, decimal_comma=True)
    rows = rows_of("t;x;when\n0,5;1.234;01.02.2025\n0,6;1,5e-1;01.02.2025\n1;2;3\n", layout, numbers=["t", "x"])
    assert values(rows) == [(0.6, 0.15), (1, 2)]
    assert aside(rows) == [2]


@pytest.mark.parametrize("ends", [("\r", "\n"), ("\n", "\r"), ("\r\n", "\r"), ("\r\r\n", "\r\r\n"), ("\n\r", "\n\r")])
def test_lines_that_end_now_so_now_so_are_all_lines(ends):
    lines = ["t,x,y", *(f"{i},{i + 1},{i + 2}" for i in range(40))]
    rows = rows_of("".join(line + ends[i % 2] for i, line in enumerate(lines)))
    assert [t for t, _, _ in values(rows)] == list(range(40))


def test_a_bar_that_a_program_drew_between_the_rows_is_no_part_of_them():
    body = "".join(f"{i},2,3\n" for i in range(4000))
    rows = rows_of(f"t,x,y\n{body}10 %\r20 %\r4000,2,3\n")
    assert rows.frame.height == 4001
    assert aside(rows) == [4002, 4002]


@pytest.mark.parametrize("encoding", ["utf-16-le", "utf-16-be", "utf-16"])
def test_a_log_in_utf_16_is_read_with_and_without_its_mark(tmp_path, encoding):
    log = mapped(tmp_path / "log.csv", "t,x,y\n1,2,3\n".encode(encoding))
    assert log.people.select("t_s", "x_m", "y_m").rows() == [(1, 2, 3)]


def test_a_column_that_is_there_twice_is_refused(tmp_path):
    with pytest.raises(DamagedLog, match="two columns are called 'x'"):
        mapped(tmp_path / "log.csv", "t,x,x,y\n1,2,9,3\n")


def test_units_with_blanks_in_the_names_do_not_hide_the_delimiter(tmp_path):
    names = "t [s];x pos [m];y pos [m];note a b c d"
    log = mapped(tmp_path / "log.csv", f"{names}\n1;2;3;x\n", time="t [s]", x="x pos [m]", y="y pos [m]")
    assert log.people.select("t_s", "x_m", "y_m").rows() == [(1, 2, 3)]


def test_names_that_stand_lower_are_found_for_the_message(tmp_path):
    with pytest.raises(MissingColumns) as refusal:
        mapped(tmp_path / "log.csv", "Station 4\n\nt;x;y\n1;2;3\n")
    assert refusal.value.cure == "They are in line 3: give skip_rows = 2, delimiter = ';'."


def test_names_in_another_encoding_are_said_to_be_so(tmp_path):
    garbled = "t,x,größe".encode("latin-1") + ",ü\n1,2,3,4\n".encode()
    with pytest.raises(DamagedLog, match="not written in utf-8: give encoding"):
        mapped(tmp_path / "log.csv", garbled, y="größe")


def test_a_year_of_two_digits_is_not_taken_for_the_year_25(tmp_path):
    how = {"time_format": "%d.%m.%Y %H:%M:%S", "time_zone": "UTC"}
    text = "t,x,y\n06.03.2025 08:00:00,1,2\n06.03.25 08:00:01,1,2\n"
    log = mapped(tmp_path / "log.csv", text, **how)
    assert log.people["t_s"].to_list() == [1741248000.0]
    assert log.set_aside["source_row"].to_list() == [3]


def test_people_whose_time_steps_back_are_told_of_and_tracks_one_after_the_other_are_not(tmp_path):
    rows = ["0,a,1,1", "1,a,1,1", "2,a,1,1", "0,b,1,1", "1,b,1,1"]
    text = "\n".join(["t,id,x,y", *rows, ""])
    assert mapped(tmp_path / "log.csv", text, person="id").warnings == ()
    (said,) = mapped(tmp_path / "log.csv", text + "0.5,b,1,1\n", person="id").warnings
    assert said.startswith("time steps back 1 time(s)")
    (said,) = mapped(tmp_path / "log.csv", "t,id,x,y\n1.7e9,a,1,1\n3,b,1,1\n", person="id").warnings
    assert said.startswith("time steps back by more than a day")


def test_a_count_below_the_rows_is_no_sample(tmp_path, ur):
    path = tmp_path / "run.csv"
    text = ur.text([ur.row(1.0), ur.row(1.008)], delimiter=",")
    path.write_text(text + "2" + "," * (len(ur.columns) - 1) + "\r\n")
    log = ur_rtde.ADAPTER.read(path, ReadOptions())
    assert log.robot["t_s"].to_list() == [1.0, 1.008]
    assert log.set_aside["reason"].to_list() == ["no value in any column that is read, except its time"]


def test_a_log_whose_every_cell_is_quoted_is_read(tmp_path, ur):
    lines = ur.text([ur.row(1.0), ur.row(1.008)]).splitlines()
    path = tmp_path / "run.csv"
    path.write_text("".join(" ".join(f'"{cell}"' for cell in line.split(" ")) + "\n" for line in lines))
    assert ur_rtde.ADAPTER.recognises(path)
    assert ur_rtde.ADAPTER.read(path, ReadOptions()).robot["t_s"].to_list() == [1.0, 1.008]


def test_a_header_of_a_million_columns_is_refused(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text(",".join(f"c{i}" for i in range(MAX_COLUMNS + 1)) + "\n")
    with pytest.raises(DamagedLog, match="more than 100 000 columns"):
        layout_below(path)


lines = st.lists(st.sampled_from("12,.x\"'\0\r \u00e9-"), max_size=9).map("".join)


@settings(deadline=None)
@given(st.lists(lines, max_size=12), st.sampled_from([COMMA, BLANK, QUOTED, replace(COMMA, delimiter=";")]))
def test_of_any_lines_a_row_holds_what_its_own_line_says(body, layout):
    text = "t,x,y\n" + "".join(f"{line}\n" for line in body)
    rows = rows_of(text.replace("\r", ""), layout)
    assert rows.rows_read == rows.frame.height + rows.set_aside.height
    for line, *numbers in rows.frame.select("source_row", "t", "x", "y").rows():
        cells = body[line - 2].replace("\r", "").replace('"', "").split(layout.delimiter)[:3]
        assert numbers == [float(cell) if cell.strip(" -") else None for cell in cells]


def test_a_control_character_in_a_cell_costs_its_row():
    rows = rows_of("t,x,y\n1,2,a\x1fb\n4,x,6\n7,8,9\n", numbers=["t", "x"])
    assert values(rows) == [(7, 8)]


def test_a_million_blanks_between_two_cells_are_one_gap():
    rows = rows_of("t x y\n1" + " " * 1_000_000 + "2\t3  \n  4 5 6\r\n", replace(COMMA, delimiter="\\s+"))
    assert values(rows) == [(1, 2, 3), (4, 5, 6)]


@pytest.mark.parametrize("run", ["\r" * 300_000, "\r" * 300_000 + "\n", " \r" * 150_000, "\n\r" * 150_000])
def test_endless_line_ends_are_passed_over_in_no_time(run):
    assert values(rows_of("t,x,y\n1,2,3\n" + run + "\n4,5,6\n")) == [(1, 2, 3), (4, 5, 6)]
    assert values(rows_of("t,x,y\r1,2,3\r" + run + "\r4,5,6\r\n")) == [(1, 2, 3), (4, 5, 6)]
