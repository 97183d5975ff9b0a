"""Names are written so that nothing takes them for a command: no terminal, no Markdown viewer, no spreadsheet."""

from __future__ import annotations

import csv
import io
import json
import re
import unicodedata

import polars as pl
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from cyclekit.errors import CyclekitError, LogError, UnknownName
from cyclekit.text.plain_json import json_text
from cyclekit.text.plain_text import NOT_ONE_LINE, all_in_one_line, csv_text, markdown, one_line, visible

BIDI = "\u061c\u200e\u200f\u202a\u202b\u202c\u202d\u202e\u2066\u2067\u2068\u2069"
ODD = st.text(
    st.one_of(st.characters(max_codepoint=0xA0), st.sampled_from(BIDI + "\u2028\u2029\ufeff"), st.characters())
)


def steers(text: str, *, ends: str = "") -> list[str]:
    """Return the characters that a terminal obeys, or that change the direction of reading."""
    return [c for c in text if c not in ends and (unicodedata.category(c) in ("Cc", "Zl", "Zp", "Cs") or c in BIDI)]


@given(ODD)
@example("\x1b]0;owned\x07\x1b[2J\x9b31m")
def test_no_control_is_left_in_a_text_and_no_end_of_line_in_a_name(text: str) -> None:
    assert not steers(visible(text), ends="\n\t")
    assert not steers(one_line(text))
    assert visible(text).count("\n") == text.count("\n")


@given(st.text(st.characters(exclude_categories=("C", "Zl", "Zp"))))
def test_a_harmless_name_stays_as_it_is(text: str) -> None:
    if not set(text) & set(BIDI):
        assert one_line(text) == visible(text) == text


@given(st.lists(ODD, max_size=5))
def test_the_pattern_for_columns_finds_what_is_escaped(texts: list[str]) -> None:
    texts = [text.encode("utf-8", "ignore").decode() for text in texts]
    found = pl.Series(texts, dtype=pl.String).str.contains(NOT_ONE_LINE)
    assert found.to_list() == [one_line(text) != text for text in texts]


@given(st.recursive(ODD, lambda inner: st.lists(inner) | st.dictionaries(ODD, inner), max_leaves=8))
def test_json_shows_no_control_and_says_the_same(value: object) -> None:
    for ascii_only in (False, True):
        text = json_text(value, ascii_only=ascii_only)
        assert not steers(text, ends="\n")
        assert json.loads(text) == value
    assert not steers(json.dumps(all_in_one_line(value), ensure_ascii=False))


def test_columns_and_the_delimiter_of_a_map_stay_as_they_are() -> None:
    told = {"path": "a\tb", "map": {"delimiter": "\t", "time": "Time\t(s)"}}
    assert all_in_one_line(told) == {**told, "path": r"a\tb"}


@given(ODD)
def test_a_name_in_an_error_begins_no_line_of_its_own(name: str) -> None:
    assert "\n" not in str(CyclekitError(name))
    assert not steers(LogError(name, name).cause)  # type: ignore[arg-type]
    assert str(UnknownName("x", "place", name, [name])).count("\n") <= 2


@given(st.lists(st.lists(st.one_of(ODD, st.floats(), st.integers(), st.none()), min_size=1), max_size=4))
def test_no_cell_of_csv_begins_a_formula_and_numbers_stay_numbers(rows: list[list[object]]) -> None:
    text = csv_text(rows)
    assert not steers(text, ends="\n\t")
    for cell in [cell for row in csv.reader(io.StringIO(text, newline="")) for cell in row]:
        if cell[:1] in tuple("=+-@\t\r\n＝＋－＠") and cell:
            float(cell)


@pytest.mark.parametrize("value", ["-1.5", "+3", "1e5", "-inf", 2.5, -7])
def test_a_number_is_written_as_it_is(value: object) -> None:
    assert csv_text([[value]]) == f"{value}\n"


@pytest.mark.parametrize("value", ["=cmd|' /C calc'!A0", "@SUM(1+1)", "+A1", "-A1", "\t=1", "＝1"])
def test_a_formula_becomes_text(value: str) -> None:
    assert csv_text([["a", value]]).split(",", 1)[1].lstrip('"').startswith("'")


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("<script>alert(1)</script>", "&lt;script>alert(1)&lt;/script>"),
        ("[a](javascript:alert(1))", r"\[a\](javascrip&#116;:alert(1))"),
        ("![a](https://evil.example/x.png)", r"\!\[a\](http&#115;://evil.example/x.png)"),
        ("&#106;avascript", "&amp;#106;avascript"),
        ("a | b\n# c", r"a \| b # c"),
        ("# heading", r"\# heading"),
        ("12. item", r"12\. item"),
        ("> quoted", r"\> quoted"),
        ("place_1->left_2: -4.5 s (95 %)", "place_1->left_2: -4.5 s (95 %)"),
        ("-4.5", "-4.5"),
    ],
)
def test_markdown_shows_a_name_as_it_is(text: str, shown: str) -> None:
    assert markdown(text) == shown


@given(ODD)
def test_no_markdown_begins_a_tag_or_a_link(text: str) -> None:
    shown = markdown(text)
    assert "<" not in shown
    assert not re.search(r"(?<!\\)[\[`*|]", shown.replace("\\\\", ""))
    assert not steers(shown)
