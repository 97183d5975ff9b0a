"""A bag of very many tiny chunks: each is looked at a fixed number of times."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import polars as pl
from bag_files import write_mcap

from cyclekit.adapter import ReadOptions
from cyclekit.ingest.registry import adapter_named
from cyclekit_adapters.rosbag.chunks import Chunk, ChunkedFile, _in_blocks
from cyclekit_adapters.rosbag.mcap_file import open_file

if TYPE_CHECKING:
    import pytest


class Counted:
    """A chunk that counts how often its size is asked for."""

    asked = 0

    @property
    def size(self) -> int:
        Counted.asked += 1
        return 100


def test_putting_chunks_together_looks_at_each_once():
    chunks = [Counted() for _ in range(3000)]
    Counted.asked = 0
    groups = list(_in_blocks(chunks))  # type: ignore[arg-type]
    assert sum(map(len, groups)) == 3000
    assert Counted.asked == 3000


def test_blocks_hold_no_more_than_they_may(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("cyclekit_adapters.rosbag.chunks.BLOCK_BYTES", 250)
    sizes = [100, 100, 100, 400, 50, 200, 1]
    groups = list(_in_blocks([Chunk(number, size, size) for number, size in enumerate(sizes)]))
    assert [[chunk.size for chunk in group] for group in groups] == [[100, 100], [100], [400], [50, 200], [1]]


def test_a_damaged_chunk_is_tried_once_and_said_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    bag = tmp_path / "x.mcap"
    bag.write_bytes(b"\0" * 100)
    tried: list[Chunk] = []
    unpack = ChunkedFile._unpack

    def counted(self: ChunkedFile, log: Any, chunk: Chunk, into: Any) -> None:
        tried.append(chunk)
        unpack(self, log, chunk, into)

    monkeypatch.setattr(ChunkedFile, "_unpack", counted)
    file = ChunkedFile(bag, None, chunks=[Chunk(0, 50, 60)])  # type: ignore[arg-type]
    with bag.open("rb") as log:
        assert file.unpacked(log, file.chunks[0]) is None
        assert file.unpacked(log, file.chunks[0]) is None
    assert (len(tried), len(file.set_aside)) == (1, 1)


def test_tiny_chunks_give_the_same_messages_as_large_ones(tmp_path: Path):
    tiny, large = tmp_path / "tiny.mcap", tmp_path / "large.mcap"
    write_mcap(tiny, 300, chunk_size=1)
    write_mcap(large, 300, chunk_size=1 << 20)
    assert len(open_file(tiny).chunks) > 100 * len(open_file(large).chunks)
    found = []
    for path in (tiny, large):
        parts = list(adapter_named("rosbag").parts(path, ReadOptions()))
        found.append(pl.concat(part.tables()["robot"] for part in parts))
    assert found[0].height == found[1].height > 0
    assert found[0].equals(found[1])
