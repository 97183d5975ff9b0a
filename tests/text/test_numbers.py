"""Whatever a number is, its text is honest: no minus zero, no interval of equal ends, no rounding to all or nothing."""

from __future__ import annotations

import ast
import math
import re
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

import cyclekit
import cyclekit_adapters
from cyclekit.text import numbers

ANY = st.one_of(
    st.none(),
    st.sampled_from([math.nan, math.inf]),
    st.floats(-1e300, 1e300),
    st.floats(-1e7, 1e7),
    st.sampled_from([0.0, -0.0, -1e-9, 1e-9, 0.9999, 1.0]),
)
TIMES = st.floats(0.0, 1e5)
WRITERS = (
    lambda value: numbers.fixed(value, 1),
    lambda value: numbers.signed(value, 2),
    numbers.significant,
    numbers.compact,
    numbers.seconds,
    numbers.percent,
    numbers.scientific,
    numbers.error_text,
)


def read(text: str) -> float:
    return float(text.split()[0])


@given(ANY)
def test_no_number_is_nan_or_a_zero_with_a_sign(value: float | None) -> None:
    for write in WRITERS:
        text = write(value)
        assert not re.search(r"nan|inf", text)
        assert not re.match(r"[-+]0*(\.0*)?(?![\d.])", text), text
        assert (text == numbers.UNKNOWN) == (value is None or not math.isfinite(value))


@given(ANY, ANY, st.integers(0, 3))
def test_no_interval_has_equal_ends(low: float | None, high: float | None, decimals: int) -> None:
    for text in (numbers.interval(low or 0.0, high or 0.0, decimals), numbers.span(low, high, decimals)):
        ends = text.split(" to ")
        assert len(ends) == 1 or ends[0] != ends[1] or numbers.UNKNOWN in ends


def test_a_narrow_interval_is_said_to_be_narrow() -> None:
    assert numbers.with_interval(1.5, 1.4999, 1.5001, 3, "m") == "1.500 m (95 % CI ± under 0.001 m)"
    assert numbers.with_interval(94.44, 92.9, 95.8, 1) == "94.4 s (95 % CI 92.9 to 95.8 s)"


@given(TIMES, TIMES)
def test_a_difference_is_that_of_the_numbers_shown(first: float, second: float) -> None:
    places = numbers.decimals_of(first, second)
    shown = [read(numbers.fixed(value, places)) for value in (first, second)]
    saved = numbers.fixed(numbers.difference(first, second, places), places)
    assert round(shown[0] - shown[1], 6) == pytest.approx(read(saved), abs=1e-9)


@given(TIMES, TIMES)
def test_times_beside_each_other_show_the_same_decimals(first: float, second: float) -> None:
    one, other = numbers.seconds(first, second), numbers.seconds(second, first)
    assert len(one.partition(".")[2]) == len(other.partition(".")[2])


@given(st.floats(0.0, 1.0), st.one_of(st.none(), st.integers(0, 3)))
def test_a_share_is_all_or_nothing_only_if_it_is(share: float, decimals: int | None) -> None:
    text = numbers.percent(share, decimals)
    assert (re.fullmatch(r"0(\.0+)?\s%", text) is not None) == (share == 0.0)
    assert (re.fullmatch(r"100(\.0+)?\s%", text) is not None) == (share == 1.0)


@pytest.mark.parametrize(
    ("write", "value", "said"),
    [
        (numbers.percent, 0.5, "50 %"),
        (numbers.percent, 0.023, "2.3 %"),
        (numbers.percent, 0.9999, "over 99 %"),
        (numbers.percent, 0.0001, "under 0.1 %"),
        (numbers.percent, math.nan, "–"),
        (numbers.whole_percent, 0.125, "12 %"),
        (numbers.exact_percent, 0.125, "12.5 %"),
        (numbers.signed_percent, -0.0001, "0.0 %"),
        (numbers.given, 27.5, "27.5"),
        (numbers.given, 95.0, "95"),
        (numbers.given, math.nan, "nan"),
        (numbers.given, -math.inf, "-inf"),
        (numbers.compact, 500.0, "500"),
        (numbers.error_text, 3.19e-4, "3.19 · 10⁻⁴"),
        (numbers.seconds, 9.994, "9.99 s"),
        (numbers.seconds, 102.94, "102.9 s"),
        (numbers.duration, 0.84, "0.8 s"),
        (numbers.duration, 59.6, "60 s"),
        (numbers.duration, 119.6, "2 min 0 s"),
        (numbers.duration, 4800.0, "1 h 20 min"),
    ],
)
def test_numbers_as_people_write_them(write: object, value: float, said: str) -> None:
    assert write(value) == said  # type: ignore[operator]


def test_one_thing_is_not_many() -> None:
    assert [numbers.counted(n, "cell") for n in (0, 1, 2)] == ["0 cells", "1 cell", "2 cells"]


FOLDER, ADAPTERS = Path(cyclekit.__file__).parent, Path(cyclekit_adapters.__file__).parent
FLOATS = re.compile(r"[+\- z]*,?(\.\d+)?[feg%]|,")
FIELD = re.compile(r"\{\w*:(?:[+,]?\.\d+)?[feg%,]\}")
FORMATS = {
    "alignment/calibrate.py": "the line of a cell file",
    "estimate/answers.py": "names of columns of a CSV file",
    "estimate/result.py": "keys of JSON",
    "learning/networks/comparison.py": "options of a command to copy",
}
"""Modules that write numbers for a file or a command, exactly: what they write is read by a program."""


def test_only_one_module_writes_numbers_for_people() -> None:
    found = []
    for file in (*FOLDER.rglob("*.py"), *ADAPTERS.rglob("*.py")):
        name = file.relative_to(FOLDER if file.is_relative_to(FOLDER) else ADAPTERS).as_posix()
        if name == "text/numbers.py" or name in FORMATS:
            continue
        source = file.read_text("utf-8")
        found += re.findall(r".*\bfixed\([^{}]*\)\} to \{fixed.*", source)  # a range may have two equal ends
        for node in ast.walk(ast.parse(source)):
            spec = node.format_spec if isinstance(node, ast.FormattedValue) else None
            if isinstance(spec, ast.JoinedStr) and FLOATS.fullmatch(
                "".join(str(getattr(part, "value", "")) for part in spec.values)
            ):
                found.append(f"{name}:{node.lineno}: {ast.unparse(node)}")
            text = node.value if isinstance(node, ast.Constant) and isinstance(node.value, str) else ""
            if FIELD.search(text) and name != "dataset/cards/notes.py":  # its sentences are filled by `by_spec`
                found.append(f"{name}:{node.lineno}: {text}")
    assert found == []


def test_the_script_of_the_page_writes_numbers_in_one_file() -> None:
    for file in (FOLDER / "report" / "play").glob("*.js"):
        if file.name != "numbers.js":
            assert not re.search(r"toFixed|toPrecision|toLocaleString", file.read_text("utf-8")), file.name


@pytest.mark.parametrize(
    ("low", "high", "decimals", "text"),
    [
        (0.92, 0.9999, None, "92 to over 99 %"),
        (0.0, 0.85, None, "0 to 85 %"),
        (0.988, 0.992, None, "± under 1 %"),
        (0.9901, 0.9903, 1, "± under 0.1 %"),
        (0.0501, 0.0502, None, "± under 0.1 %"),
    ],
)
def test_an_interval_of_shares_never_has_two_equal_ends(
    low: float, high: float, decimals: int | None, text: str
) -> None:
    assert numbers.percent_interval(low, high, decimals) == text
