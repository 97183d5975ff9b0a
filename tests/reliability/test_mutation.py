"""Logs harmed at random: one of our tables or one of our refusals, soon, and no other exception.

`benchmarks/mutation.py` harms the same logs thousands of times, and real ones.
"""

from __future__ import annotations

import tempfile
import tracemalloc
import zlib
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from examples import at_most, drawn
from hypothesis import given
from hypothesis import strategies as st
from reliability.mutate import TOKENS, WORD, mutants
from reliability.own_logs import OwnLog, own_logs
from reliability.reading import FOREIGN, LIMIT_S, PARTLY, READ, REFUSED, read_log

from cyclekit.ingest.registry import adapter_named

if TYPE_CHECKING:
    from reliability.reading import Result

EACH = drawn(12)


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> list[OwnLog]:
    return own_logs(tmp_path_factory.mktemp("own"))


def read_harmed(log: OwnLog, file: str, harmed: bytes) -> Result:
    with tempfile.TemporaryDirectory() as folder:
        for name, data in log.files.items():
            (Path(folder) / name).write_bytes(harmed if name == file else data)
        path = Path(folder) / file if len(log.files) == 1 else Path(folder)
        return read_log(path, log.adapter, log.options)


def test_logs_of_every_adapter_are_harmed(logs: list[OwnLog]):
    from cyclekit.ingest.registry import adapters

    assert {log.adapter for log in logs} >= set(adapters()) - {"events"}  # is read by `csv` as well


@pytest.mark.slow  # quick: the damage tests of each adapter
def test_a_harmed_log_gives_one_of_our_tables_or_one_of_our_refusals(logs: list[OwnLog]):
    outcomes = set()
    for log in logs:
        for file, data in log.files.items():
            seed = zlib.crc32(f"{log.name} {file}".encode())
            for harm, harmed in mutants(data, seed, EACH // len(log.files) + 1, large=False):
                result = read_harmed(log, file, harmed)
                assert result.outcome != FOREIGN, f"{log.name}/{file}, {harm}: {result.why}"
                assert result.seconds < 3 * LIMIT_S
                outcomes.add(result.outcome)
    assert outcomes == {READ, PARTLY, REFUSED}


@at_most(60)
@given(data=st.data())
def test_any_bytes_anywhere_in_a_log_are_read_or_refused(logs: list[OwnLog], data: st.DataObject):
    log = data.draw(st.sampled_from(logs))
    file = data.draw(st.sampled_from(sorted(log.files)))
    whole = log.files[file]
    begin = data.draw(st.integers(0, len(whole)))
    end = data.draw(st.integers(begin, len(whole)))
    harmed = whole[:begin] + data.draw(st.binary(max_size=40)) + whole[end:]
    result = read_harmed(log, file, harmed)
    assert result.outcome != FOREIGN, result.why


@at_most(100)
@given(data=st.data())
def test_any_word_of_a_log_may_be_any_nonsense(logs: list[OwnLog], data: st.DataObject):
    """Headers state counts, rates and flags, so the first words are drawn as often as all others together."""
    log = data.draw(st.sampled_from(logs))
    file = data.draw(st.sampled_from(sorted(log.files)))
    whole = log.files[file]
    words = [found.span() for found in WORD.finditer(whole)]
    begin, end = data.draw(st.sampled_from(words[:60]) | st.sampled_from(words))
    result = read_harmed(log, file, whole[:begin] + data.draw(st.sampled_from(TOKENS)) + whole[end:])
    assert result.outcome != FOREIGN, result.why


def test_a_cell_of_a_million_blanks_costs_no_more_than_its_line(logs: list[OwnLog], tmp_path: Path):
    log = next(log for log in logs if log.name == "ur-space")
    lines = log.files["log.csv"].decode().splitlines()
    lines[9] = lines[9].replace(" ", " " * 1_000_000, 1)
    lines[12] = lines[12].replace(" ", ",", 1)
    (tmp_path / "log.csv").write_bytes("\r\n".join([*lines, ""]).encode())
    tracemalloc.start()
    try:
        found = adapter_named(log.adapter).adapter.read(tmp_path / "log.csv", log.options)
        most = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert found.set_aside is not None
    assert found.set_aside["source_row"].to_list() == [10, 13]
    assert found.rows_read == len(lines) - 1
    assert most < 40e6  # one such line; were every line as wide, forty times as much


def test_metadata_of_many_megabytes_is_not_even_read(logs: list[OwnLog], monkeypatch: pytest.MonkeyPatch):
    bag = next(log for log in logs if log.name == "bag mcap")
    name = next(name for name in bag.files if name.endswith(".yaml"))
    looked, read_text = [], Path.read_text
    monkeypatch.setattr(
        Path, "read_text", lambda path, *how, **more: looked.append(path.name) or read_text(path, *how, **more)
    )
    assert read_harmed(bag, name, bag.files[name]).outcome == READ
    assert looked.count(name) > 0
    looked.clear()
    assert read_harmed(bag, name, bag.files[name] + b"xy" * 10_000_000).outcome == READ
    assert name not in looked


def test_zeros_behind_the_magic_word_of_a_bag_are_no_records(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    from cyclekit.adapter import ReadOptions
    from cyclekit_adapters.rosbag import ros1_file

    looked, header = [], ros1_file._header
    monkeypatch.setattr(ros1_file, "_header", lambda log: looked.append(log.tell()) or header(log))
    (tmp_path / "run.bag").write_bytes(b"#ROSBAG V2.0\n" + bytes(1 << 16))
    assert read_log(tmp_path / "run.bag", "rosbag", ReadOptions()).outcome == REFUSED
    assert 0 < len(looked) < 10
