"""Small blocks of numbers alone are parsed without a query, and the rows are the same."""

from __future__ import annotations

from unittest import mock

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from cyclekit_adapters.text import block_table
from cyclekit_adapters.text.delimited import TextLayout
from cyclekit_adapters.text.text_rows import Wanted

numbers = st.one_of(st.floats(allow_nan=False, allow_infinity=False).map(repr), st.integers(-(10**20), 10**20).map(str))
cells = st.one_of(
    numbers, st.sampled_from(["", "1.", ".5", "+1", "1e", "-", "1e999", "1-2", "e5", "1.2.3", "00", "-0"])
)
lines = st.one_of(st.lists(numbers, min_size=3, max_size=3), st.lists(cells, min_size=0, max_size=4))


def bits(table):
    """The values as they are stored, the unknown ones apart."""
    columns = [column.fill_null(0.0).to_numpy().view(np.int64).tolist() for column in table.frame]
    return table.frame.columns, columns, table.frame.to_dict(as_series=False), table.lines, table.not_finite


@given(
    st.lists(lines, min_size=1, max_size=6), st.sampled_from(",; \t"), st.sampled_from(["\n", "\r\n"]), st.booleans()
)
def test_the_short_way_finds_what_the_long_one_does(rows, mark, end, last_too):
    layout = TextLayout(("a", "b", "c"), mark, header_lines=0)
    wanted = Wanted(("a", "b", "c") if last_too else ("a", "b"))
    block = "".join(mark.join(row) + end for row in rows).encode()
    short = block_table.table_of(block, layout, wanted)
    with mock.patch.object(block_table, "_plain", return_value=None):
        long = block_table.table_of(block, layout, wanted)
    assert (short is None) == (long is None)
    if short is not None and long is not None:
        assert bits(short) == bits(long)


def test_a_log_of_numbers_alone_takes_the_short_way():
    layout = TextLayout(("a", "b", "c"), " ", header_lines=0)
    with mock.patch.object(block_table, "_parsed", side_effect=AssertionError):
        for end in ("\n", "\r\n"):
            table = block_table.table_of(f"1 -2.5 3e-3{end}4 5 6{end}".encode(), layout, Wanted(("c", "a")))
            assert table is not None
            assert table.frame.rows() == [(3e-3, 1.0), (6.0, 4.0)]
