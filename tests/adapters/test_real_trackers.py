"""Tracker logs that real trackers wrote; expected values were read off the files' own bytes.

The files are not part of the project: the environment variable CYCLEKIT_SAMPLES names the folder that holds them.
"""

import csv
import json
import os
from pathlib import Path

import numpy as np
import pytest
from damage import read_damaged

from cyclekit.adapter import ReadOptions
from cyclekit.errors import DamagedLog, LogError
from cyclekit.ingest.registry import adapters, find_adapter

FOLDER = Path(os.environ.get("CYCLEKIT_SAMPLES", "absent"))
pytestmark = pytest.mark.skipif(not FOLDER.is_dir(), reason="CYCLEKIT_SAMPLES names no folder")


def read(name, adapter, **options):
    found = find_adapter(FOLDER / name)
    assert found is not None
    assert found.name == adapter
    return found.adapter.read(FOLDER / name, ReadOptions(**options))


def test_of_a_vicon_trial_the_person_is_the_middle_of_four_pelvis_markers():
    log = read("vicon/markers.csv", "vicon")
    assert log.people.height == log.rows_read == 580
    assert set(log.people["person"]) == {"Daphnee"}
    # frame 1: x of ASISr, ASISl, PSISr, PSISl is 667.12, 753.439, 853.113, 889.774 mm
    assert log.people.row(0)[2:5] == pytest.approx((0.7908615, 0.219800675, 0.20088425), abs=1e-9)
    assert log.people.row(294)[0] == pytest.approx(2.94)
    assert log.people.row(294)[2:5] == pytest.approx((0.76622025, 0.1952725, 0.208107), abs=1e-9)
    assert log.people["x_m"].null_count() == 0
    assert (log.up, log.facts["rate_hz"], log.facts["not_people"]) == ("z", "100", "boite")


def test_a_vicon_marker_is_unknown_in_exactly_the_frames_whose_cells_are_empty():
    log = read("vicon/markers.csv", "vicon", body="Daphnee:SCAP_CP")
    with (FOLDER / "vicon/markers.csv").open(newline="") as file:
        rows = list(csv.reader(file))
    at = rows[2].index("Daphnee:SCAP_CP")
    raw = [float(row[at]) / 1000 if row[at] else None for row in rows[5:]]
    assert log.people["x_m"].to_list() == pytest.approx(raw)
    assert log.people["x_m"].null_count() == 92


def test_a_vicon_file_of_emg_alone_has_no_positions():
    with pytest.raises(DamagedLog, match="no positions"):
        read("vicon/analogs.csv", "vicon")


def test_zed_bodies_keep_their_place_their_time_and_their_metres():
    log = read("zed/body_tracking.json", "zed")
    frames = json.loads((FOLDER / "zed/body_tracking.json").read_text())
    raw = sorted((b["ts"] / 1000, *b["keypoint"][0]) for frame in frames for b in frame)
    assert sorted(log.people.select("t_s", "x_m", "y_m", "z_m").rows()) == raw
    assert log.people.height == 97
    assert (log.rows_read, log.clock, log.up) == (65, "epoch", "y")
    assert log.facts["unit"].startswith("m, since bodies are 1.")
    assert log.facts["frames_without_bodies"] == "2"


def test_zed_ids_that_are_new_in_every_frame_become_the_two_people_who_were_there():
    log = read("zed/body_tracking.json", "zed")
    tracks = {who[0]: rows.select("x_m", "y_m", "z_m").to_numpy() for who, rows in log.people.group_by("person")}
    assert sorted(map(len, tracks.values())) == [34, 63]
    for places in tracks.values():
        assert np.linalg.norm(np.diff(places, axis=0), axis=1).max() < 0.5
    assert tracks["1"][0] == pytest.approx((0.2292940318584442, -0.5564967797, -0.8392819166))
    assert tracks["2"][0] == pytest.approx((2.5849559307, -0.2357947826, -3.0308241844))
    assert tracks["2"][-1] == pytest.approx((0.8927862048, -0.2395310402, -2.2636122704))


def test_an_empty_zed_recording_is_said_to_be_one():
    with pytest.raises(LogError, match="no body in any"):
        read("zed/empty-list/body_tracking.json", "zed")


def test_kinect_v2_rows_are_the_base_of_the_spine_at_ticks_of_100_ns():
    log = read("kinect2/joints.csv", "kinect2")
    assert log.people.height == 371
    assert log.people.row(0) == (pytest.approx(3186.7373716), "1", 0.0710328, -0.600598, 0.978207, 1)
    assert log.people.row(370) == (pytest.approx(3199.1373804), "1", 0.17904, -0.495084, 0.771162, 371)
    assert log.people["t_s"].diff().median() == pytest.approx(1 / 30, abs=2e-3)
    assert log.set_aside.is_empty()
    assert "in 47 of 371 rows" in log.warnings[0]


@pytest.mark.parametrize(
    "name", ["vicon/markers.csv", "vicon-objects/3.csv", "zed/body_tracking.json", "kinect2/joints.csv"]
)
def test_a_damaged_copy_gives_what_is_whole_or_a_refusal(tmp_path, name):
    path = tmp_path / Path(name).name
    found = find_adapter(FOLDER / name)
    read_damaged(found.adapter, path, (FOLDER / name).read_bytes(), seed=9, cuts=4, flips=6)


def test_every_real_log_has_one_reader_at_most():
    claimed = {
        path.relative_to(FOLDER).as_posix(): [
            name for name, entry in adapters().items() if entry.adapter.recognises(path)
        ]
        for path in FOLDER.rglob("*")
    }
    assert {path: names for path, names in claimed.items() if len(names) > 1} == {}


def test_the_segments_of_a_vicon_object_export_are_one_person_at_the_hip():
    log = read("vicon-objects/3.csv", "vicon", skeletons=True)
    assert log.people.height == log.rows_read == 673  # frames 31 to 703, each once
    assert set(log.people["person"]) == {"person"}
    # frame 31: TX, TY, TZ of hip:hip are -280.423645, -1436.598022, 244.102982 mm, at 100 Hz
    assert log.people.row(0) == (
        0.3,
        "person",
        pytest.approx(-0.280423645),
        pytest.approx(-1.436598022),
        0.244102982,
        6,
    )
    assert log.people["t_s"][-1] == pytest.approx(7.02)
    assert log.people["x_m"].null_count() == 0
    assert (log.up, log.facts["rate_hz"], log.facts["section"]) == ("z", "100", "Objects")
    assert log.skeletons["joint"].unique().len() == 9
    assert log.set_aside.is_empty()
