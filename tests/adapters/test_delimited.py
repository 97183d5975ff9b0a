import gzip
import tempfile
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path
from unittest import mock

import pytest
from backports import zstd
from hypothesis import example, given
from hypothesis import strategies as st

from cyclekit.errors import DamagedLog
from cyclekit_adapters.text import block_table, delimited, row_parser, text_blocks
from cyclekit_adapters.text.delimited import TextLayout, header_names, read_blocks, read_rows
from cyclekit_adapters.text.header_line import layout_below
from cyclekit_adapters.text.text_blocks import encoding_of

LAYOUT = TextLayout(("a", "b", "c"), ",", header_lines=1)

cells = st.sampled_from(
    ["1", "-2.5", "", " 3", "4e2", "x", "nan", "inf", "0x1", '"5"', '"', "1.2.3", "\0", "é", "1 ", "True"]
)
lines = st.lists(cells, min_size=0, max_size=5).map(",".join)
ends = st.sampled_from(["\n", "\r\n", "\n\n"])


@contextmanager
def written(text):
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "log.csv"
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        yield path


def rows_of(text, layout=LAYOUT, **columns):
    with written(text) as path:
        return read_rows(path, layout, **(columns or {"numbers": ["a", "b", "c"]}))


def plain(rows):
    """The columns asked for and the line, without the number of the row."""
    return rows.frame.drop(delimited.INDEX)


@given(st.lists(st.tuples(lines, ends), max_size=8), st.booleans(), st.booleans())
def test_reading_fast_and_looking_at_every_line_give_the_same_rows(body, cut, quotes):
    text = "a,b,c\n" + "".join(line + end for line, end in body)
    text = text[:-1] if cut and body else text
    layout = replace(LAYOUT, quotes=quotes)
    for columns in ({"numbers": ["a", "b", "c"]}, {"numbers": ["b"]}, {"numbers": ["a"], "texts": ["b"]}):
        fast = rows_of(text, layout, **columns)
        with mock.patch.object(row_parser, "table_of", return_value=None):
            careful = rows_of(text, layout, **columns)
        assert fast.frame.equals(careful.frame)
        assert fast.set_aside.equals(careful.set_aside)
        assert fast.rows_read == careful.rows_read


@given(st.lists(st.tuples(lines, ends), max_size=30), st.booleans(), st.integers(1, 40), st.sampled_from([8, 64]))
@example(body=[("", "\n")] * 3 + [("-2.5", "\n\n"), ("1,1,1", "\n")], cut=False, block=7, halving=8)
def test_a_log_in_small_blocks_gives_the_rows_of_one_block(body, cut, block, halving):
    text = "a,b,c\n" + "".join(line + end for line, end in body)
    text = text[:-1] if cut and body else text
    at_once = rows_of(text)
    small = [(text_blocks, "BLOCK_BYTES", block), (text_blocks, "_STEP", 3), (row_parser, "ONE_BY_ONE", halving)]
    with ExitStack() as stack:
        for module, name, value in small:
            stack.enter_context(mock.patch.object(module, name, value))
        in_blocks = rows_of(text)
    assert in_blocks.frame.equals(at_once.frame)
    assert in_blocks.set_aside.equals(at_once.set_aside)
    assert in_blocks.rows_read == at_once.rows_read


@given(
    st.lists(st.sampled_from(["1,2,3", "4,5,6", "", "7,8", " "]), max_size=12), st.sampled_from(["\n", "\r\n", "\r"])
)
def test_a_row_names_the_line_of_the_file_that_it_stands_in(lines, end):
    text = end.join(["a,b,c", *lines, ""])
    rows = rows_of(text)
    numbered = dict(enumerate(lines, 2))
    whole = [number for number, line in numbered.items() if line.count(",") == 2]
    assert rows.frame["source_row"].to_list() == whole
    assert [f"{a:g},{b:g},{c:g}" for a, b, c in rows.frame.select("a", "b", "c").rows()] == [numbered[n] for n in whole]
    assert rows.set_aside["source_row"].to_list() == [n for n, line in numbered.items() if line.count(",") == 1]


def test_one_garbled_row_in_a_large_block_costs_that_row_alone():
    body = [f"{i},{2 * i},{3 * i}" for i in range(40_000)]
    body[31_234] = "31234,x,5"
    rows = rows_of("a,b,c\n" + "\n".join(body) + "\n")
    assert rows.frame.height == 39_999
    assert rows.set_aside.rows() == [(31_236, "'x' in column 'b' is not a number")]
    assert rows.frame["source_row"].to_list() == [i + 2 for i in range(40_000) if i != 31_234]


def test_the_header_once_more_is_no_row_and_the_log_goes_on():
    rows = rows_of("a,b,c\n1,2,3\na,b,c\n4,5,6\n")
    assert plain(rows).rows() == [(2, 1, 2, 3), (4, 4, 5, 6)]
    assert rows.set_aside.rows() == [(3, "the header is repeated")]


def test_what_follows_the_names_of_another_table_is_not_taken_for_this_one():
    rows = rows_of("a,b,c\n1,2,3\nForce,Torque,Sum\n4,5,6\n7,8,9\n")
    assert plain(rows).rows() == [(2, 1, 2, 3)]
    assert rows.set_aside["source_row"].to_list() == [3, 4, 5]
    assert "another table begins in line 3 (Force, Torque, Sum)" in rows.set_aside["reason"][2]


def test_an_empty_last_cell_is_no_short_row():
    rows = rows_of("a,b,c\n1,2,\n3,4,5\n6,7,\n")
    assert plain(rows).rows() == [(2, 1, 2, None), (3, 3, 4, 5), (4, 6, 7, None)]
    assert rows.set_aside.is_empty()


def test_an_empty_last_cell_does_not_hide_a_short_row_and_one_too_long():
    rows = rows_of("a,b,c\n1,2,\n3,4\n6,7,8,\n9,10,11,12\n")
    assert plain(rows).rows() == [(2, 1, 2, None), (4, 6, 7, 8)]
    assert rows.set_aside["source_row"].to_list() == [3, 5]


@pytest.mark.parametrize("delimiter", ["||", "::", "\\s+"])
def test_a_delimiter_may_be_several_characters_or_any_run_of_blanks(delimiter):
    between = " \t  " if delimiter == "\\s+" else delimiter
    text = "\n".join(between.join(row) for row in (["a", "b", "c"], ["1", "2", "3"], ["4", "5"], ["6", "7", "8"]))
    rows = rows_of(f"{text}\n", replace(LAYOUT, delimiter=delimiter))
    assert plain(rows).rows() == [(2, 1, 2, 3), (4, 6, 7, 8)]
    assert rows.set_aside["source_row"].to_list() == [3]


@pytest.mark.parametrize("pack", [gzip.compress, zstd.compress])
def test_a_packed_log_is_read_as_the_log_itself(pack):
    text = b"a,b,c\n" + b"".join(b"%d,%d,%d\n" % (i, i, i) for i in range(500))
    packed, unpacked = rows_of(pack(text)), rows_of(text)
    assert packed.frame.equals(unpacked.frame)
    assert packed.frame.height == 500


def test_a_packed_log_that_was_cut_is_refused():
    with pytest.raises(DamagedLog, match="compressed data is damaged"):
        rows_of(gzip.compress(b"a,b,c\n" + b"1,2,3\n" * 9000)[:-40])


@pytest.mark.slow
def test_a_bomb_is_refused_long_before_it_is_unpacked():
    packed = zstd.compress(b"1,2,3\n" * 20_000_000)
    assert len(packed) < 64_000
    with written(packed) as path, pytest.raises(DamagedLog, match="unpacks to more than 1000 times"):
        list(read_blocks(path, LAYOUT, numbers=["a"]))


def test_a_line_longer_than_any_logger_writes_is_refused():
    with written(b"a,b,c\n" + b"1" * (40 << 20)) as path, pytest.raises(DamagedLog, match="line of more than 16 MiB"):
        read_rows(path, LAYOUT, numbers=["a"])


def test_a_header_of_seventeen_thousand_columns_is_read_whole():
    names = [f"signal_number_{i}" for i in range(17_000)]
    with written(",".join(names) + "\n" + ",".join(map(str, range(17_000))) + "\n") as path:
        layout = layout_below(path)
        assert layout.names == tuple(names)
        rows = read_rows(path, layout, numbers=["signal_number_16999", "signal_number_3"])
    assert rows.frame.row(0)[2:] == (16999.0, 3.0)


@given(st.lists(st.tuples(*[st.floats(allow_nan=False, allow_infinity=False)] * 3), min_size=1, max_size=20))
def test_every_number_comes_back_as_it_was_written(rows):
    text = "a,b,c\n" + "".join(",".join(map(repr, row)) + "\n" for row in rows)
    assert rows_of(text).frame.select("a", "b", "c").rows() == rows


@given(st.binary(max_size=300))
def test_any_bytes_at_all_are_rows_or_set_aside(noise):
    rows = rows_of(b"a,b,c\n1,2,3\n" + noise)
    assert rows.rows_read == rows.frame.height + rows.set_aside.height


def test_an_empty_cell_nan_and_infinity_are_unknown():
    rows = rows_of("a,b,c\n1,,nan\n2,inf,-inf\n")
    assert plain(rows).rows() == [(2, 1, None, None), (3, 2, None, None)]
    assert rows.not_finite == 3
    assert rows_of("a,b,c\n1,,NaN\n2,inf,-inf\nx,nan,1\n").not_finite == 3  # those of rows that are set aside are not


def test_quotes_around_a_text_with_the_delimiter_inside_are_understood():
    layout = replace(LAYOUT, quotes=True)
    rows = rows_of('a,b,c\n1,"x, y",3\n2,z,4\n', layout, numbers=["a", "c"], texts=["b"])
    assert rows.frame["b"].to_list() == ["x, y", "z"]
    assert rows.frame["c"].to_list() == [3, 4]


def test_a_decimal_comma_is_a_decimal_mark():
    layout = TextLayout(("a", "b"), ";", header_lines=1, decimal_comma=True)
    assert plain(rows_of("a;b\n0,5;1,25\n1;x\n", layout, numbers=["a", "b"])).rows() == [(2, 0.5, 1.25)]


def test_columns_of_one_name_or_none_do_not_hide_each_other():
    assert header_names("t,x,,x,,\n", ",") == ("t", "x", "#3", "x#2")


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


@given(st.lists(st.sampled_from([b"1.5", b" ", b"-", b"\r\n", b"\n", b"\t", b"\0"]), max_size=12), st.integers(1, 9))
def test_two_blanks_and_nul_are_found_wherever_a_block_is_looked_at_in_pieces(pieces, looked_at):
    block = b"".join(pieces)
    with mock.patch.object(block_table, "_LOOKED_AT", looked_at):
        assert block_table._has_nul_or_two_blanks(block) == (b"\0" in block or b"  " in block)


def test_numbers_too_large_to_be_added_are_numbers():
    rows = rows_of("a,b,c\n1,1e308,2\n2,1.7e308,nan\n3,1e308,1\n")
    assert rows.frame["b"].to_list() == [1e308, 1.7e308, 1e308]
    assert rows.frame["c"].to_list() == [2.0, None, 1.0]
    assert rows.not_finite == 1
    assert rows_of("a,b,c\n1,1e308,2\n2,1.7e308,3\n").not_finite == 0
