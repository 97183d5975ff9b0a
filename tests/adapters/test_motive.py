import pytest

from cyclekit.adapter import ReadOptions
from cyclekit.config import Source
from cyclekit.errors import DamagedLog, LogError, UnknownName
from cyclekit.ingest.discover import options_of
from cyclekit_adapters.formats.motive import ADAPTER


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


def test_a_body_on_the_flange_is_read_beside_the_named_person_and_is_no_person(tmp_path, motive):
    text = motive({"Helmet": [(1.0, 0, 0)], "Box": [(2.0, 0, 0)], "Flange": [None]})
    source = Source("take.csv", role="people", body="Helmet", sees="tcp", sees_as="Flange")
    (tmp_path / "take.csv").write_text(text, "utf-8", newline="")
    log = ADAPTER.read(tmp_path / "take.csv", options_of(source))
    assert dict(log.people.select("person", "x_m").rows()) == {"Flange": None, "Helmet": 1.0}
    assert log.warnings == ()
    both = read(tmp_path / "take.csv", text, flange="Flange")
    assert sorted(both.people["person"].to_list()) == ["Box", "Flange", "Helmet"]
    assert any("2 bodies tracked (Helmet, Box)" in said for said in both.warnings)
    assert read(tmp_path / "take.csv", text, body="Box", flange="Flang").people["person"].to_list() == ["Box"]


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
    assert "deviates from frame / rate by up to 0.5 s, first in line 1108" in log.warnings[0]


def test_a_take_that_a_german_spreadsheet_saved_again_is_read_alike(tmp_path, motive):
    text = motive({"Helmet": [(1.5, 1.75, 3.0), None]}, rate_hz=120.0)
    saved = text.replace(",", ";").replace(".", ",").replace("\r\n\r\n", "\r\n;;;;;;;;\r\n")
    log = read(tmp_path / "take.csv", saved)
    assert log.people.rows() == read(tmp_path / "take.csv", text).people.rows()
    assert log.people.select("x_m", "y_m").rows() == [(1.5, 1.75), (None, None)]


def columns(kinds, names, components, axes):
    """The five rows above the data of a take, written out."""
    rows = [["", "Type", *kinds], ["", "Name", *names], ["", "ID", *("6D" for _ in kinds)], ["", "", *components]]
    return [",".join(row) for row in [*rows, ["Frame", "Time (Seconds)", *axes]]]


def take(head, *rows, line="Format Version,1.25,Take Name,walk,Export Frame Rate,100,Length Units,Meters"):
    return "\r\n".join([line, "", *head, *rows, ""])


XYZ, PLACE = ["X", "Y", "Z"], ["Position"] * 3


def test_a_skeleton_is_the_person_and_the_box_beside_it_is_not(tmp_path):
    kinds, names = ["Rigid Body"] * 3 + ["Bone"] * 3, ["Box"] * 3 + ["Ann"] * 3
    text = take(columns(kinds, names, PLACE * 2, XYZ * 2), "0,0.00,5,1,5,1,0.9,2", "1,0.01,5,1,5,1.5,0.9,2")
    log = read(tmp_path / "take.csv", text)
    assert log.people.select("person", "x_m").rows() == [("Ann", 1.0), ("Ann", 1.5)]
    assert any("rigid bodies (Box) are left out" in said for said in log.warnings)
    box = read(tmp_path / "take.csv", text, body="Box")
    assert box.people["x_m"].to_list() == [5.0, 5.0]
    assert not any("left out" in said for said in box.warnings)


def test_of_a_marker_set_with_a_pelvis_the_pelvis_is_the_person(tmp_path):
    names = ["Ann:WaistLFront"] * 3 + ["Ann:WaistRBack"] * 3 + ["Ann:LHandOut"] * 3
    text = take(
        columns(["Marker"] * 9, names, PLACE * 3, XYZ * 3), "0,0,1,0.9,0,2,0.9,0,9,9,9", "1,0.01,1,1,0,,,,9,9,9"
    )
    log = read(tmp_path / "take.csv", text)
    assert log.people.select("x_m", "y_m").rows() == [(1.5, 0.9), (1.0, 1.0)]


@pytest.mark.parametrize(
    ("name", "known"), [("walk, morning", "walk, morning"), ('"walk, morning"', "walk, morning"), ("a,b,c", "a, b, c")]
)
def test_the_name_of_a_take_may_hold_commas(tmp_path, name, known):
    line = f"Format Version,1.23,Take Name,{name},Take Notes,,Export Frame Rate,100,Length Units,Millimeters,,,"
    head = columns(["Rigid Body"] * 3, ["vest"] * 3, PLACE, XYZ)
    log = read(tmp_path / "take.csv", take(head, "0,0,1000,0,0", line=line))
    assert log.people["x_m"].to_list() == [1.0]
    assert log.facts["Take Name"] == known


@pytest.mark.parametrize("kind", ["Rigid Body Marker", "Bone Marker"])
def test_places_where_a_marker_should_be_are_said_to_be_filled_in(tmp_path, kind):
    text = take(columns([kind] * 3, ["vest:1"] * 3, PLACE, XYZ), "0,0.00,1,1,1", "1,0.01,1,1,1")
    assert any("computed" in said for said in read(tmp_path / "take.csv", text).warnings)
    both = columns([kind] * 3 + ["Marker"] * 3, ["vest:1"] * 6, PLACE * 2, XYZ * 2)
    log = read(tmp_path / "take.csv", take(both, "0,0.00,1,1,1,2,2,2", "1,0.01,1,1,1,,,"))
    assert log.people["x_m"].to_list() == [2.0, None]
    assert not any("computed" in said for said in log.warnings)


def test_euler_angles_stand_in_three_columns_before_the_position(tmp_path):
    head = columns(["Rigid Body"] * 6, ["vest"] * 6, ["Rotation"] * 3 + PLACE, XYZ * 2)
    assert read(tmp_path / "take.csv", take(head, "0,0,10,20,30,1,1.7,3")).people["y_m"].to_list() == [1.7]


def test_an_export_turned_to_z_up_is_said_in_the_cell_file(tmp_path, motive):
    text = motive({"Helmet": [(1.0, 2.0, 1.7)]})
    log = read(tmp_path / "take.csv", text, map={"up": "z"})
    assert (log.up, log.people["z_m"].to_list()) == ("z", [1.7])
    with pytest.raises(UnknownName, match="'x'"):
        read(tmp_path / "take.csv", text, map={"up": "x"})
