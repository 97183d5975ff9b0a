"""Digital inputs of a UR controller as events, and a tracker's clock that they tell."""

import json

import numpy as np
import pytest

from cyclekit.adapter import ReadOptions
from cyclekit.config import load_cell
from cyclekit.errors import MissingColumns, UnknownName
from cyclekit.ingest.ingest import ingest
from cyclekit_adapters.formats.ur_rtde import ADAPTER
from cyclekit_adapters.text import text_blocks

INPUTS = "actual_digital_input_bits"


def run(ur, bits, begin=100.0):
    return ur.text([ur.row(begin + 0.1 * i) | {INPUTS: value} for i, value in enumerate(bits)])


def read(path, text, **options):
    path.write_text(text, newline="")
    return ADAPTER.read(path, ReadOptions(**options))


def test_each_change_of_an_input_is_an_event_and_the_first_state_is_none(tmp_path, ur):
    log = read(tmp_path / "run.csv", run(ur, [2, 2, 3, 2**17 + 1, 0]), map={"inputs": "events"})
    assert log.events.select("signal", "value", "source_row").rows() == [
        ("digital-input 0", "1", 4),
        ("digital-input 1", "0", 5),
        ("digital-input 17", "1", 5),
        ("digital-input 0", "0", 6),
        ("digital-input 17", "0", 6),
    ]
    assert log.events["t_s"].to_list() == pytest.approx([100.2, 100.3, 100.3, 100.4, 100.4])
    assert log.robot.height == 5


def test_changes_between_blocks_are_found_once(tmp_path, ur, monkeypatch):
    text = run(ur, [i // 7 % 2 for i in range(200)])
    whole = read(tmp_path / "run.csv", text, map={"inputs": "events"})
    monkeypatch.setattr(text_blocks, "BLOCK_BYTES", 2048)
    parts = list(ADAPTER.stream(tmp_path / "run.csv", ReadOptions(map={"inputs": "events"})))
    assert len(parts) > 5
    assert sum(part.events.height for part in parts) == whole.events.height == 28


def test_inputs_are_read_where_the_cell_file_asks_for_them_only(tmp_path, ur):
    assert read(tmp_path / "run.csv", run(ur, [0, 1])).events is None
    with pytest.raises(UnknownName, match="'all'"):
        read(tmp_path / "run.csv", run(ur, [0, 1]), map={"inputs": "all"})
    with pytest.raises(MissingColumns, match=INPUTS):
        read(tmp_path / "run.csv", ur.text([ur.row(1.0)]), map={"inputs": "events"})


CELL = """
[[sources]]
path = "run.csv"
map = { inputs = "events" }

[[sources]]
path = "walk.tsv"
sync = { robot = "digital-input 3", other = "pulse" }
"""


def test_a_pulse_that_robot_and_tracker_saw_tells_the_trackers_clock(tmp_path, ur):
    pulses = [2.0, 5.0, 11.0, 17.5]  # s of the tracker, which began 3.2 s after the robot's log
    bits = [8 * any(0 <= 0.1 * i - 3.2 - pulse < 0.45 for pulse in pulses) for i in range(300)]
    (tmp_path / "logs").mkdir()
    (tmp_path / "logs" / "run.csv").write_text(run(ur, bits), newline="")
    head = ["NO_OF_FRAMES\t2000", "NO_OF_MARKERS\t1", "FREQUENCY\t100", "DATA_INCLUDED\t3D", "MARKER_NAMES\tPelvis"]
    head += [f"EVENT\tpulse\t{round(100 * t) + 1}\t{t:.5f}" for t in pulses]
    rows = [f"{i + 1}\t{i / 100:.5f}\t{1000 + i}\t0\t950" for i in range(2000)]
    (tmp_path / "logs" / "walk.tsv").write_text("\r\n".join([*head, *rows, ""]), newline="")
    (tmp_path / "logs" / "cell.toml").write_text(CELL)
    ingest([tmp_path / "logs"], tmp_path / "dataset", cell=load_cell(tmp_path / "logs" / "cell.toml"))
    card = json.loads((tmp_path / "dataset" / "dataset.json").read_text())
    (clock,) = [entry["clock"] for entry in card["recordings"] if "walk" in str(entry)]
    assert clock["method"] == "event-pairs"
    assert clock["offset_s"] == pytest.approx(3.2, abs=0.06)  # the robot's rows are 0.1 s apart
    assert clock["events"] == len(pulses)
    assert np.isfinite(clock["residual_s"])
