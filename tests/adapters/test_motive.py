import pytest

from cyclekit.adapter import ReadOptions
from cyclekit.errors import DamagedLog, LogError
from cyclekit_adapters.motive import ADAPTER


def read(path, text, **options):
    path.write_bytes(text.encode())
    assert ADAPTER.recognises(path)
    return ADAPTER.read(path, ReadOptions(**options))


@pytest.mark.parametrize("version", ["1.21", "1.23"])
def test_the_position_stands_behind_the_rotation(tmp_path, motive, version):
    log = read(tmp_path / "take.csv", motive({"Helmet": [(1.0, 1.7, 3.0), (1.5, 1.7, 3.0)]}, version=version))
    assert log.people.select("x_m", "y_m", "z_m").rows() == [(1.0, 1.7, 3.0), (1.5, 1.7, 3.0)]
    assert log.people["person"].to_list() == ["Helmet", "Helmet"]
    assert (log.up, log.clock) == ("y", "relative")
    assert log.robot is None


@pytest.mark.parametrize(("unit", "metres"), [("Meters", 1.0), ("Millimeters", 1e-3), ("Centimeters", 1e-2)])
def test_lengths_come_in_the_unit_of_the_first_line(tmp_path, motive, unit, metres):
    log = read(tmp_path / "take.csv", motive({"Helmet": [(100.0, 170.0, 300.0)]}, unit=unit))
    assert log.people["y_m"][0] == pytest.approx(170.0 * metres)


def test_time_is_the_frame_over_the_rate_even_where_the_time_column_is_rounded(tmp_path, motive):
    track = {"Helmet": [(0.0, 0.0, 0.0)] * 4}
    log = read(tmp_path / "take.csv", motive(track, rate_hz=120.0, seconds=[0, 0.008, 0.017, 0.025]))
    assert log.people["t_s"].to_list() == pytest.approx([0, 1 / 120, 2 / 120, 3 / 120], abs=1e-12)
    assert log.warnings == ()


def test_a_time_column_that_contradicts_the_rate_wins_and_is_said(tmp_path, motive):
    track = {"Helmet": [(0.0, 0.0, 0.0)] * 3}
    log = read(tmp_path / "take.csv", motive(track, rate_hz=240.0, seconds=[0, 0.5, 1.0], padding=4))
    assert log.people["t_s"].to_list() == [0, 0.5, 1.0]
    assert "240 Hz" in log.warnings[0]


def test_a_body_that_no_camera_saw_is_unknown_and_keeps_its_row(tmp_path, motive):
    log = read(tmp_path / "take.csv", motive({"Helmet": [(1.0, 2.0, 3.0), None, (4.0, 5.0, 6.0)]}))
    assert log.people["x_m"].to_list() == [1.0, None, 4.0]
    assert log.set_aside.is_empty()
    assert any("1 of 3 frames" in said for said in log.warnings)


def test_several_bodies_are_several_people_unless_one_is_chosen(tmp_path, motive):
    text = motive({"Helmet": [(1.0, 0, 0)], "Box": [(2.0, 0, 0)]})
    both = read(tmp_path / "take.csv", text)
    assert sorted(both.people["person"].to_list()) == ["Box", "Helmet"]
    assert any("`body`" in said for said in both.warnings)
    box = read(tmp_path / "take.csv", text, body="Box")
    assert box.people["x_m"].to_list() == [2.0]
    with pytest.raises(LogError, match="'helmet'") as refusal:
        read(tmp_path / "take.csv", text, body="helmet")
    assert refusal.value.nearest == "Helmet"


def test_a_skeleton_is_tracked_by_its_hip(tmp_path, motive):
    text = motive({"Ann:Chest": [(9.0, 1.3, 0)], "Ann:Hip": [(1.0, 0.9, 0)], "Bo:Hip": [(2.0, 0.9, 0)]}, kind="Bone")
    log = read(tmp_path / "take.csv", text)
    assert dict(log.people.select("person", "x_m").rows()) == {"Ann": 1.0, "Bo": 2.0}


def test_a_marker_set_is_the_middle_of_the_markers_that_were_seen(tmp_path, motive):
    markers = {
        "Vest:1": [(0.0, 1.0, 0.0), (0.0, 1.0, 0.0)],
        "Vest:2": [(1.0, 1.0, 2.0), None],
        "Unlabeled:7": [(9.0, 9.0, 9.0), None],
    }
    log = read(tmp_path / "take.csv", motive(markers, kind="Marker"))
    assert log.people.select("person", "x_m", "z_m").rows() == [("Vest", 0.5, 1.0), ("Vest", 0.0, 0.0)]
    one = read(tmp_path / "take.csv", motive(markers, kind="Marker"), body="Vest:2")
    assert one.people["x_m"].to_list() == [1.0, None]


def test_positions_relative_to_a_parent_are_refused(tmp_path, motive):
    with pytest.raises(DamagedLog, match="relative to a parent"):
        read(tmp_path / "take.csv", motive({"Helmet": [(1.0, 0, 0)]}, space="Local"))


def test_an_unknown_unit_is_refused_with_the_nearest(tmp_path, motive):
    with pytest.raises(DamagedLog, match="Metres") as refusal:
        read(tmp_path / "take.csv", motive({"Helmet": [(1.0, 0, 0)]}, unit="Metres"))
    assert refusal.value.nearest == "Meters"


def test_an_export_without_header_is_not_recognised_and_refused_when_forced(tmp_path):
    path = tmp_path / "take.csv"
    path.write_text("0,0.000,0.1,0.2,0.3,0.9,1,2,3\n1,0.004,0.1,0.2,0.3,0.9,1,2,3\n")
    assert not ADAPTER.recognises(path)
    with pytest.raises(DamagedLog, match="no header"):
        ADAPTER.read(path, ReadOptions())


def test_a_take_of_only_a_header_is_refused(tmp_path, motive):
    with pytest.raises(DamagedLog, match="a header and no rows"):
        read(tmp_path / "take.csv", motive({"Helmet": []}))


def test_a_last_row_cut_while_being_written_is_set_aside(tmp_path, motive):
    text = motive({"Helmet": [(1.0, 0, 0.25), (2.0, 0, 0.125)]})
    log = read(tmp_path / "take.csv", text[:-4])
    assert log.people["x_m"].to_list() == [1.0]
    assert log.set_aside["source_row"].to_list() == [9]


def test_the_bones_of_a_skeleton_are_its_joints_on_request(tmp_path, motive):
    bones = {"Ann:Hip": [(1.0, 0.9, 0.5)], "Ann:LHand": [None], "Bo:Hip": [(2.0, 0.9, 0.5)]}
    log = read(tmp_path / "take.csv", motive(bones, kind="Bone"), skeletons=True)
    assert log.skeletons.rows() == [
        (0.0, "Ann", "hip", 1.0, 0.9, 0.5, 8),
        (0.0, "Ann", "lhand", None, None, None, 8),
        (0.0, "Bo", "hip", 2.0, 0.9, 0.5, 8),
    ]
    assert set(
        read(tmp_path / "take.csv", motive(bones, kind="Bone"), skeletons=True, body="Bo").skeletons["person"]
    ) == {"Bo"}
    assert read(tmp_path / "take.csv", motive(bones, kind="Bone")).skeletons is None


def test_a_take_with_timecodes_parents_and_marker_errors_is_read_by_its_axes(tmp_path):
    lines = [
        "Format Version,1.25,Take Name,walk,Take Notes,,Export Frame Rate,120,Length Units,Centimeters",
        "",
        ",Type,,Rigid Body,Rigid Body,Rigid Body,Rigid Body,Rigid Body,Rigid Body,Rigid Body,Rigid Body",
        ",Name,,vest,vest,vest,vest,vest,vest,vest,vest",
        ',ID,,"6D","6D","6D","6D","6D","6D","6D","6D"',
        ",Parent,,,,,,,,,",
        ",,,Rotation,Rotation,Rotation,Rotation,Position,Position,Position,Mean Marker Error",
        "Frame,Time (Seconds),TimeCode,X,Y,Z,W,X,Y,Z,",
        "72210,601.75,15:26:46:12.02,0,0,0,1,150,90,-30,0.0004",
        "72211,601.758333,15:26:46:12.03,,,,,,,,",
    ]
    log = read(tmp_path / "take.csv", "\r\n".join([*lines, ""]))
    assert log.people.rows() == [(72210 / 120, "vest", 1.5, 0.9, -0.3, 9), (72211 / 120, "vest", None, None, None, 10)]
    assert log.set_aside.is_empty()


def test_where_time_and_frames_part_late_in_a_take_that_is_said(tmp_path, motive):
    seconds = [i / 100 for i in range(1100)] + [11.5 + i / 100 for i in range(100)]
    log = read(tmp_path / "take.csv", motive({"Helmet": [(1.0, 0, 0)] * 1200}, seconds=seconds))
    assert log.people["t_s"][-1] == pytest.approx(11.99)
    assert "departs from frame / rate by up to 0.5 s, first in line 1108" in log.warnings[0]


def test_a_take_that_a_german_spreadsheet_saved_again_is_read_alike(tmp_path, motive):
    text = motive({"Helmet": [(1.5, 1.75, 3.0), None]}, rate_hz=120.0)
    saved = text.replace(",", ";").replace(".", ",").replace("\r\n\r\n", "\r\n;;;;;;;;\r\n")
    log = read(tmp_path / "take.csv", saved)
    assert log.people.rows() == read(tmp_path / "take.csv", text).people.rows()
    assert log.people.select("x_m", "y_m").rows() == [(1.5, 1.75), (None, None)]
