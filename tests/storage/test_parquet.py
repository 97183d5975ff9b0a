"""Parquet tables written piece by piece and read by ranges of rows: what is kept, what is said, full disks."""

from __future__ import annotations

import gc
import sys
import threading
from concurrent.futures import ThreadPoolExecutor
from itertools import groupby
from pathlib import Path

import numpy as np
import polars as pl
import pyarrow.parquet as pq
import pytest
from examples import at_most
from hypothesis import given
from hypothesis import strategies as st

from cyclekit import schema
from cyclekit.storage import parquet as tables
from cyclekit.storage import parquet_layout as table_layout


def test_a_table_that_is_given_up_makes_no_noise_when_it_goes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    complaints: list[object] = []
    monkeypatch.setattr(sys, "unraisablehook", complaints.append)
    monkeypatch.setattr(tables, "GROUP_ROWS", 2)
    writer = tables.TableWriter(tmp_path / "a.parquet", schema.EVENTS)
    writer.write(pl.concat([schema.empty(schema.EVENTS), pl.DataFrame({"t_s": [1.0, 2.0, 3.0]})], how="diagonal"))
    writer.abandon()
    del writer
    gc.collect(1)
    assert complaints == []


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="a disk that is always full is a thing of Linux")
@pytest.mark.parametrize("pieces", [1, 40])
def test_a_full_disk_is_said_of_a_table_written_behind_too(pieces: int, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(tables, "GROUP_ROWS", 20_000)
    rows = schema.conform(pl.DataFrame({"t_s": np.random.default_rng(0).normal(size=10_000)}), schema.EVENTS)
    before = threading.active_count()

    def write_all() -> None:
        with tables.TableWriter(Path("/dev/full"), schema.EVENTS) as writer:
            for _ in range(pieces):
                writer.write(rows)

    with pytest.raises(OSError, match="No space left") as told:
        write_all()
    assert told.value.filename == "/dev/full"
    assert threading.active_count() == before


def test_what_was_decoded_is_kept_up_to_its_limit_and_the_oldest_goes_first(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(tables, "_KEPT_BYTES", 100)
    kept = tables._Decoded()
    monkeypatch.setattr(tables, "_decoded", kept)
    keys = [(Path("a"), "x", number) for number in range(5)]
    for key in keys[:3]:
        kept.keep(key, np.zeros(5))  # 40 bytes each
    assert [kept.get(key) is not None for key in keys[:3]] == [False, True, True]
    kept.get(keys[1])
    kept.keep(keys[3], np.zeros(5))  # the one looked at last stays
    assert [kept.get(key) is not None for key in keys[:4]] == [False, True, False, True]
    kept.keep(keys[4], np.zeros(500))
    assert [kept.get(key) is not None for key in keys] == [False] * 4 + [True]
    with tables.keeping(1000):
        for key in keys[:3]:
            kept.keep(key, np.zeros(5))
        assert all(kept.get(key) is not None for key in keys[:3])
    assert kept.get(keys[1]) is None
    with tables.keeping(1000):
        kept.keep(keys[1], np.zeros(5))
    assert kept.get(keys[1]) is not None  # no more than is kept anyway


def test_what_two_threads_decoded_is_counted_once(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(tables, "_KEPT_BYTES", 100)
    kept = tables._Decoded()
    for _ in range(5):  # as many threads may read the same columns at the same time
        kept.keep((Path("a"), "x", 0), np.zeros(5))
    kept.keep((Path("a"), "x", 1), np.zeros(5))
    assert kept.get((Path("a"), "x", 0)) is not None


def test_several_threads_read_one_table(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(tables, "GROUP_ROWS", 10)
    monkeypatch.setattr(tables, "_KEPT_BYTES", 400)
    monkeypatch.setattr(tables, "_decoded", tables._Decoded())
    t = np.arange(200.0)
    with tables.TableWriter(tmp_path / "a.parquet", schema.EVENTS) as writer:
        writer.write(schema.conform(pl.DataFrame({"t_s": t}), schema.EVENTS))
    table = tables.StoredTable(tmp_path / "a.parquet", ("t_s",))

    def read(seed: int) -> bool:
        spans = np.sort(np.random.default_rng(seed).integers(0, 200, (100, 2)), axis=1)
        return all((table.read(a, b)["t_s"] == t[a:b]).all() for a, b in spans.tolist())

    with ThreadPoolExecutor(4) as workers:
        assert all(workers.map(read, range(4)))


texts = st.lists(st.tuples(st.sampled_from(["playing", "paused", "", None]), st.integers(1, 6)), max_size=8)


@given(runs=texts, group_rows=st.integers(1, 9))
@at_most(60)
def test_stretches_of_equal_texts_do_not_depend_on_the_pieces_of_a_table(
    runs: list[tuple[str | None, int]], group_rows: int, tmp_path_factory: pytest.TempPathFactory
):
    values = [text for text, many in runs for _ in range(many)]
    frame = pl.DataFrame({"signal": pl.Series(values, dtype=pl.String)})
    file = tmp_path_factory.mktemp("states") / "a.parquet"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(tables, "GROUP_ROWS", group_rows)
        with tables.TableWriter(file, schema.EVENTS) as writer:
            writer.write(schema.conform(frame, schema.EVENTS))
    expected, at = [], 0
    for text, rows in groupby(values):
        many = len(list(rows))
        expected += [] if text is None else [(at, at + many - 1, text)]
        at += many
    assert list(tables.StoredTable(file, ()).states("signal")) == expected


_TEXTS = st.lists(st.sampled_from([None, "playing", "paused"]), min_size=1, max_size=30)


@at_most(30)
@given(_TEXTS, st.lists(st.one_of(st.none(), st.floats(allow_nan=False), st.just(0.0)), min_size=30, max_size=30))
def test_a_small_table_read_as_a_whole_says_what_it_says_in_pieces(
    tmp_path_factory: pytest.TempPathFactory, texts: list[str | None], numbers: list[float | None]
):
    file = tmp_path_factory.mktemp("table") / "a.parquet"
    count = len(texts)
    columns = {"t_s": range(count), "scaling": numbers[:count], "state": texts, "register": [None, *range(count - 1)]}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(tables, "GROUP_ROWS", 7)
        with tables.TableWriter(file, schema.ROBOT) as table:
            table.write(schema.conform(pl.DataFrame(columns, strict=False), schema.ROBOT))
    said = []
    for small in (1 << 20, 0):
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(table_layout, "SMALL_BYTES", small)
            patch.setattr(tables, "_decoded", tables._Decoded())
            table_layout.layout_of.cache_clear()
            table = tables.StoredTable(file, ("t_s", "scaling", "state", "register"))
            assert (table._layout().whole is not None) == bool(small)
            parts = [table.whole_numbers(number, "register") for number in range(len(table.groups))]
            read = table.column("scaling", 1, count), table.column("t_s", 0, 3)
            said.append([table.rows, table.groups, [table.unknown(name) for name in table.columns]])
            said[-1] += [np.concatenate([np.ravel(part) for part in parts]).tolist(), *(str(part) for part in read)]
            said[-1].append(list(table.states("state")))
    assert said[0] == said[1]


@pytest.mark.parametrize(("rows", "packing"), [(100, "LZ4"), (tables.SMALL_ROWS + 1, "ZSTD")])
def test_a_small_table_is_packed_by_what_begins_faster(tmp_path: Path, rows: int, packing: str):
    frame = schema.conform(pl.DataFrame({"t_s": np.arange(float(rows))}), schema.EVENTS)
    with tables.TableWriter(tmp_path / "a.parquet", schema.EVENTS) as table:
        table.write(frame)
    about = pq.ParquetFile(tmp_path / "a.parquet").metadata.row_group(0)
    assert {about.column(number).compression for number in range(about.num_columns)} == {packing}
    assert pl.read_parquet(tmp_path / "a.parquet").equals(frame)


@pytest.mark.parametrize(("rows", "whole"), [(1000, True), (1_100_000, False)])
def test_a_file_of_few_bytes_that_holds_many_rows_is_not_read_as_a_whole(tmp_path: Path, rows: int, whole: bool):
    frame = pl.DataFrame({"t_s": pl.zeros(rows, eager=True), "state": pl.repeat("x" * 10, rows, eager=True)})
    with pq.ParquetWriter(tmp_path / "a.parquet", frame[:1].to_arrow().schema, compression="zstd") as table:
        for begin in range(0, rows, 1_000_000):
            table.write_table(frame[begin : begin + 1_000_000].to_arrow())
    assert (tmp_path / "a.parquet").stat().st_size < table_layout.SMALL_BYTES
    layout = tables.StoredTable(tmp_path / "a.parquet", ("t_s",))._layout()
    assert (layout.whole is not None) == whole
    if layout.whole is not None:
        assert layout.whole.columns == ["t_s"]  # a text may be as long as all others together
