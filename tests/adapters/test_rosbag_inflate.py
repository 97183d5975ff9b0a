"""Chunks are unpacked piece by piece, and one that is broken only once."""

import bz2
import struct
from unittest.mock import patch

import lz4.frame
import numpy as np
import pytest
from backports import zstd
from bag_files import chunk_record, expected, places, write_mcap, write_ros1
from hypothesis import given
from hypothesis import strategies as st

from cyclekit_adapters.rosbag import chunks, inflate
from cyclekit_adapters.rosbag.payloads import Damage

PACK = {"lz4": lz4.frame.compress, "zstd": zstd.compress, "bz2": bz2.compress}
packed = st.sampled_from(sorted(PACK))
texts = st.builds(lambda piece, times: piece * times, st.binary(min_size=1, max_size=300), st.integers(1, 60))
small = st.integers(1, 400)


@given(packed, texts, small, small)
def test_in_whatever_pieces_it_goes_the_bytes_are_the_same(kind, text, step, taken):
    with patch.object(inflate, "_STEP", step), patch.object(inflate, "_SLICE", taken):
        room = np.empty(len(text), np.uint8)
        assert inflate.inflate(PACK[kind](text), kind, room)[0] == len(text)
        assert room.tobytes() == text


@given(packed, texts, small, small, st.data())
def test_in_whatever_pieces_it_goes_a_lie_is_found_and_a_cut_one_begins_alike(kind, text, step, taken, data):
    stored = PACK[kind](text)
    with patch.object(inflate, "_STEP", step), patch.object(inflate, "_SLICE", taken):
        with pytest.raises(Damage, match="less"):
            inflate.inflate(stored, kind, np.empty(len(text) + 1, np.uint8))
        with pytest.raises(Damage, match="more"):
            inflate.inflate(stored, kind, np.empty(len(text) - 1, np.uint8))
        cut = stored[: data.draw(st.integers(1, len(stored) - 1))]
        room = np.empty(len(text), np.uint8)
        filled, _ = inflate.inflate(cut, kind, room, whole=False)
        assert room[:filled].tobytes() == text[:filled]


@pytest.mark.parametrize("kind", sorted(PACK))
def test_no_more_is_handed_over_at_once_than_a_slice(kind, monkeypatch):
    given_, make = [], inflate._decompressor

    class Watched:
        def __init__(self, name):
            self.inner = make(name)

        def __getattr__(self, name):
            return getattr(self.inner, name)

        def decompress(self, piece, max_length):
            given_.append(len(piece))
            return self.inner.decompress(piece, max_length=max_length)

    monkeypatch.setattr(inflate, "_decompressor", Watched)
    monkeypatch.setattr(inflate, "_SLICE", 1000)
    text = np.random.default_rng(0).bytes(50_000)
    stored = PACK[kind](text)
    inflate.inflate(stored, kind, np.empty(len(text), np.uint8))
    assert max(given_) == 1000
    assert sum(given_) == len(stored)


def bag_record(head, data):
    fields = b"".join(struct.pack("<I", len(field)) + field for field in head)
    return struct.pack("<I", len(fields)) + fields + struct.pack("<I", len(data)) + data


@pytest.mark.parametrize("form", ["mcap", "bag"])
def test_a_chunk_that_is_broken_is_unpacked_once_and_named_once(tmp_path, monkeypatch, form):
    stored, tried = lz4.frame.compress(bytes(range(256)) * 400), []

    def watched(raw, *rest, **how):
        tried.append(raw)
        return inflate.inflate(raw, *rest, **how)

    if form == "bag":
        path = write_ros1(tmp_path / "run.bag", 20)
        whole = path.read_bytes()
        at = len(b"#ROSBAG V2.0\n") + 4096  # what describes the bag is filled up to this
        broken = bag_record([b"op=\5", b"compression=lz4", b"size=" + struct.pack("<I", 1000)], stored)
    else:
        path = write_mcap(tmp_path / "run.mcap", 20)
        whole = path.read_bytes()
        at = whole.index(b"\x0f" + struct.pack("<Q", 4))
        broken = chunk_record(stored, 1000, "lz4")
    path.write_bytes(whole[:at] + broken + whole[at:])
    monkeypatch.setattr(chunks, "inflate", watched)
    tcp, _, _, aside = places(path)
    assert tcp == expected(20)[0]
    assert len(aside) == 1
    assert "more than the 1000 bytes" in aside[0]
    assert tried.count(stored) == 1
