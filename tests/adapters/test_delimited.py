import tempfile
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cyclekit_adapters.delimited import Layout, encoding_of, header_names, read_rows

LAYOUT = Layout(("a", "b", "c"), ",", header_lines=1)

cells = st.sampled_from(
    ["1", "-2.5", "", " 3", "4e2", "x", "nan", "inf", "0x1", '"5"', '"', "1.2.3", "\0", "é", "1 ", "True"]
)
lines = st.lists(cells, min_size=0, max_size=5).map(",".join)
ends = st.sampled_from(["\n", "\r\n", "\n\n"])


def rows_of(text, layout=LAYOUT, **columns):
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "log.csv"
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        return read_rows(path, layout, **(columns or {"numbers": ["a", "b", "c"]}))


@settings(max_examples=120, deadline=None)
@given(st.lists(st.tuples(lines, ends), max_size=8), st.booleans(), st.booleans())
def test_reading_fast_and_looking_at_every_line_give_the_same_rows(body, cut, quotes):
    text = "a,b,c\n" + "".join(line + end for line, end in body)
    text = text[:-1] if cut and body else text
    layout = replace(LAYOUT, quotes=quotes)
    for columns in ({"numbers": ["a", "b", "c"]}, {"numbers": ["b"]}, {"numbers": ["a"], "texts": ["b"]}):
        fast = rows_of(text, layout, **columns)
        careful = rows_of(text, replace(layout, careful=True), **columns)
        assert fast.frame.equals(careful.frame)
        assert fast.set_aside["source_row"].to_list() == careful.set_aside["source_row"].to_list()
        assert fast.rows_read == careful.rows_read


@settings(max_examples=100, deadline=None)
@given(st.lists(st.tuples(*[st.floats(allow_nan=False, allow_infinity=False)] * 3), min_size=1, max_size=20))
def test_every_number_comes_back_as_it_was_written(rows):
    text = "a,b,c\n" + "".join(",".join(map(repr, row)) + "\n" for row in rows)
    assert rows_of(text).frame.select("a", "b", "c").rows() == rows


@settings(max_examples=100, deadline=None)
@given(st.binary(max_size=300))
def test_any_bytes_at_all_are_rows_or_set_aside(noise):
    rows = rows_of(b"a,b,c\n1,2,3\n" + noise)
    assert rows.rows_read == rows.frame.height + rows.set_aside.height


def test_an_empty_cell_nan_and_infinity_are_unknown():
    assert rows_of("a,b,c\n1,,nan\n2,inf,-inf\n").frame.rows() == [(0, 1, None, None), (1, 2, None, None)]


def test_quotes_around_a_text_with_the_delimiter_inside_are_understood():
    layout = replace(LAYOUT, quotes=True)
    rows = rows_of('a,b,c\n1,"x, y",3\n2,z,4\n', layout, numbers=["a", "c"], texts=["b"])
    assert rows.frame["b"].to_list() == ["x, y", "z"]
    assert rows.frame["c"].to_list() == [3, 4]


def test_a_decimal_comma_is_a_decimal_mark():
    layout = Layout(("a", "b"), ";", header_lines=1, decimal_comma=True)
    assert rows_of("a;b\n0,5;1,25\n1;x\n", layout, numbers=["a", "b"]).frame.rows() == [(0, 0.5, 1.25)]


def test_columns_of_one_name_or_none_do_not_hide_each_other():
    assert header_names("t,x,,x,,\n", ",") == ("t", "x", "#1", "x#2")


@pytest.mark.parametrize(
    ("first", "encoding"),
    [
        (b"a,b\n", "utf-8"),
        (b"\xef\xbb\xbfa,b", "utf-8-sig"),
        ("a,b".encode("utf-16"), "utf-16"),
        ("a,b\n".encode("utf-16-le"), "utf-16-le"),
        (b"\0\0\0\0", None),
        (b"\x89PNG\0\n", None),
    ],
)
def test_the_first_bytes_tell_the_encoding(first, encoding):
    assert encoding_of(first) == encoding
