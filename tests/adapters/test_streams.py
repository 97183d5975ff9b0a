"""A log that is read in parts is the log read at once, whatever the size of the parts."""

from __future__ import annotations

import pytest
from tracker_logs import WRITERS

from cyclekit.adapter import ReadOptions, StreamingAdapter, concat_parts
from cyclekit.ingest.registry import adapter_named

RATED = ReadOptions(rate_hz=25.0, skeletons=True)


@pytest.mark.parametrize("block_bytes", [1, 100, 500])
@pytest.mark.parametrize("name", WRITERS)
def test_parts_of_a_log_are_together_the_log_read_at_once(tmp_path, monkeypatch, name, block_bytes):
    frames = 40 if block_bytes == 500 else 16  # else nearly every line is a part
    path = WRITERS[name](tmp_path, frames)
    adapter = adapter_named(name).adapter
    assert isinstance(adapter, StreamingAdapter)
    at_once = adapter.read(path, RATED)
    monkeypatch.setattr("cyclekit_adapters.text.text_blocks.BLOCK_BYTES", block_bytes)
    parts = list(adapter.stream(path, RATED))
    together = concat_parts(parts)
    assert len(parts) > 1
    assert at_once.tables().keys() == together.tables().keys()
    for table, frame in at_once.tables().items():
        assert frame.height > 0.75 * frames
        assert together.tables()[table].equals(frame), table
    assert (together.set_aside.sort("source_row")).equals(at_once.set_aside.sort("source_row"))
    assert (together.warnings, together.facts) == (at_once.warnings, at_once.facts)
    assert (together.rows_read, together.clock, together.up) == (at_once.rows_read, at_once.clock, at_once.up)


@pytest.mark.parametrize("name", WRITERS)
def test_every_part_has_the_same_tables_clock_and_axes(tmp_path, monkeypatch, name):
    path = WRITERS[name](tmp_path, 40)
    monkeypatch.setattr("cyclekit_adapters.text.text_blocks.BLOCK_BYTES", 500)
    parts = list(adapter_named(name).adapter.stream(path, RATED))
    kinds = {(tuple(part.tables()), part.clock, part.up, part.rows_are, part.joint_names) for part in parts}
    assert len(kinds) == 1


@pytest.mark.parametrize("name", WRITERS)
def test_without_asking_for_them_no_skeleton_is_kept(tmp_path, name):
    log = adapter_named(name).adapter.read(WRITERS[name](tmp_path, 4), ReadOptions(rate_hz=25.0))
    assert log.skeletons is None
