"""One reader of TOML tables: what is wrong is named with file, table, key and what was expected, and the cure works."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from cyclekit.config import load_cell
from cyclekit.config.sequences import load_sequences
from cyclekit.errors import ConfigError
from cyclekit.estimate.plan import load_jobs
from cyclekit.estimate.whatif import load_changes
from cyclekit.fleet import load_fleet

Load = Callable[[Path], object]

SLIPS: list[tuple[Load, str, str, str]] = [
    (load_cell, "", "rate_hz = 0", "rate_hz = 0: expected a number >= 0.1"),
    (load_cell, "", 'ignore = "truth/*"', "ignore must be a list"),
    (load_cell, "", "levels = [0, 50]", "levels[1] = [0, 50]: expected a number <= 1.0"),
    (
        load_cell,
        "[places.home]\n",
        "xyz_m = [0, 0]",
        "[places.home]: xyz_m = [0, 0]: expected a list of length 3, got 2",
    ),
    (load_cell, "[executions]\n", "bit = 63", "executions: bit = 63: expected a whole number <= 62"),
    (load_cell, "[executions]\n", "home = 3", "executions: home = 3: expected a text, got a whole number"),
    (load_jobs, 'visit = ["a", "b"]\n', "start = 3", "start = 3: expected a text"),
    (load_sequences, "[[sequence]]\nname = 'A'\n", 'places = "a"', "sequence[0]: places must be a list"),
    (load_changes, "[[change]]\nfrequency = 0.5\n", "levels = [nan, 1]", "change[0]: levels[0] = [nan, 1]: expected"),
    (load_fleet, '[[cell]]\nname = "a"\n', "sources = []", "cell[0]: sources = []: expected a list of length >= 1"),
    (load_fleet, '[[cell]]\nsources = ["x"]\n', 'name = "../a"', "cell[0]: name = '../a': expected a text matching"),
]


def said(load: Load, file: Path, text: str) -> ConfigError:
    file.write_text(text, encoding="utf-8")
    with pytest.raises(ConfigError) as caught:
        load(file)
    return caught.value


@pytest.mark.parametrize(("load", "head", "line", "seen"), SLIPS)
def test_a_slip_is_named_and_what_the_message_offers_is_right(
    load: Load, head: str, line: str, seen: str, tmp_path: Path
) -> None:
    file = tmp_path / "x.toml"
    error = said(load, file, head + line)
    assert error.seen.startswith(str(file))
    assert seen in error.seen
    cure = error.cure or ""
    if re.match(r"\w+ = ", cure):  # a line to type: then it is no longer what is wrong
        tomllib.loads(cure)
        file.write_text(head + cure, encoding="utf-8")
        try:
            load(file)
        except ConfigError as other:
            assert "expected" not in other.seen  # noqa: PT017


@pytest.mark.parametrize(
    ("load", "key"),
    [(load_sequences, "sequence"), (load_changes, "change"), (load_fleet, "cell"), (load_cell, "sources")],
)
def test_a_list_of_tables_that_holds_something_else_is_refused(load: Load, key: str, tmp_path: Path) -> None:
    error = said(load, tmp_path / "x.toml", f"{key} = [3]")
    assert f"{key}[0]: 3 must be a table" in error.seen


KEYS = st.sampled_from(
    [
        "name",
        "sources",
        "places",
        "levels",
        "executions",
        "robot",
        "rate_hz",
        "cell",
        "fleet",
        "change",
        "sequence",
        "visit",
        "start",
        "before",
        "zones",
        "base",
        "frame",
        "path",
        "map",
        "xyz_m",
        "dh",
        "model",
        "epochs",
        "tasks",
    ]
)
LEAF = st.booleans() | st.integers(-3, 99) | st.sampled_from(["nan", "inf", "1e300", '"a"', '"a->b"', "2026-01-01"])


def as_toml(value: object) -> str:
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{key} = {as_toml(inner)}" for key, inner in value.items()) + " }"
    if isinstance(value, list):
        return "[" + ", ".join(map(as_toml, value)) + "]"
    return str(value).lower() if isinstance(value, bool) else str(value)


VALUE = st.recursive(LEAF, lambda inner: st.lists(inner, max_size=3) | st.dictionaries(KEYS, inner, max_size=3))


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.dictionaries(KEYS, VALUE, max_size=3))
@pytest.mark.parametrize("load", [load_cell, load_jobs, load_sequences, load_changes, load_fleet])
def test_whatever_a_file_holds_it_is_followed_or_refused_in_one_message(
    load: Load, tmp_path: Path, content: dict[str, object]
) -> None:
    file = tmp_path / "x.toml"
    file.write_text("\n".join(f"{key} = {as_toml(value)}" for key, value in content.items()), encoding="utf-8")
    try:
        load(file)
    except ConfigError as error:
        assert error.seen.startswith((str(file), "change "))  # noqa: PT017
        assert error.cure or error.nearest  # noqa: PT017
