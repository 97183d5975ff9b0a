"""The last line of a logger that was killed is never believed, wherever in the line that was, by no adapter of text."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from reliability.own_logs import OwnLog, own_logs

from cyclekit.ingest.registry import adapter_named, adapters

if TYPE_CHECKING:
    from cyclekit.adapter import Recording

BINARY = {"c3d", "rosbag"}
JSON = {"azure-kinect", "zed"}  # cut by frames, not by lines
REFUSED = {"mediapipe"}
LINES = sorted(set(adapters()) - BINARY - JSON - REFUSED - {"events"})


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> list[OwnLog]:
    ended = {"ur binary", "task json", "xes"}  # these say themselves where they end
    texts = [log for log in own_logs(tmp_path_factory.mktemp("own")) if log.name not in ended]
    events = [OwnLog("events", "events", {"log.csv": EVENTS.encode()})]
    return [*texts, *events]


EVENTS = "t_s,signal,value\n" + "".join(f"{row}.25,goal_button,{row % 2}\n" for row in range(12))


def read(log: OwnLog, file: str, data: bytes) -> Recording:
    with tempfile.TemporaryDirectory() as folder:
        for name, whole in log.files.items():
            (Path(folder) / name).write_bytes(data if name == file else whole)
        path = Path(folder) / file if len(log.files) == 1 else Path(folder)
        return adapter_named(log.adapter).adapter.read(path, log.options)


@pytest.mark.parametrize("adapter", [*LINES, "events"])
def test_a_last_line_without_its_end_is_not_read(adapter: str, logs: list[OwnLog]):
    mine = [log for log in logs if log.adapter == adapter and log.name != "trace xml"]
    assert mine
    for log in mine:
        for file, whole in log.files.items():
            text = whole.rstrip()
            begin = text.rfind(b"\n") + 1
            without = read(log, file, whole[:begin]).tables()
            size = len(text) - begin
            assert any(table.height for table in without.values())
            for cut in sorted({1, 2, size // 3, size // 2, size - 1, size}):
                found = read(log, file, text[: begin + cut])
                for name, table in found.tables().items():
                    assert table.equals(without[name]), f"{log.name}/{file}: {text[begin : begin + cut]!r} was read"
                assert found.set_aside is not None
                assert "cut" in found.set_aside["reason"][-1]


@pytest.mark.parametrize("adapter", sorted(JSON))
def test_a_frame_that_was_not_written_to_its_end_is_not_read(adapter: str, logs: list[OwnLog]):
    (log,) = (log for log in logs if log.adapter == adapter)
    ((file, whole),) = log.files.items()
    (people,) = read(log, file, whole).tables().values()
    size, heights = len(whole), []
    for cut in [size * k // 23 for k in range(8, 23)]:
        (found,) = read(log, file, whole[:cut]).tables().values()
        assert found.equals(people.head(found.height))
        heights.append(found.height)
    assert heights == sorted(heights)
    assert heights[0] < heights[-1] < people.height
