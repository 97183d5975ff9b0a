import pytest
from damage import read_damaged, read_or_refuse
from hypothesis import given
from hypothesis import strategies as st

from cyclekit.adapter import ReadOptions
from cyclekit.errors import ConfigError, DamagedLog, LogError
from cyclekit.ingest.registry import adapters
from cyclekit_adapters.formats.vicon import ADAPTER

HIPS = {"Subject:LASI": [(0, 100, 900), (10, 100, 900)], "Subject:RASI": [(200, 100, 1000), None]}


def section(markers, *, title="Trajectories", rate=100, unit="mm", first=1, mark=",", decimal="."):
    """Return the lines of one section, as Nexus writes them."""
    frames = len(next(iter(markers.values())))
    lines = [title, str(rate)]
    lines.append(mark * 2 + mark.join(f"{name}{mark}{mark}" for name in markers))
    lines.append(mark.join(["Frame", "Sub Frame", *("X", "Y", "Z") * len(markers)]))
    lines.append(mark * 2 + mark.join([unit] * 3 * len(markers)))
    for i in range(frames):
        cells = [str(first + i), "0"]
        for track in markers.values():
            cells += [str(v).replace(".", decimal) for v in track[i]] if track[i] else [""] * 3
        lines.append(mark.join(cells))
    return lines


def read(path, lines, **options):
    path.write_bytes(("\r\n".join(lines) + "\r\n").encode())
    assert [name for name, entry in adapters().items() if entry.adapter.recognises(path)] == ["vicon"]
    return ADAPTER.read(path, ReadOptions(**options))


def test_the_person_is_the_middle_of_the_pelvis_markers_that_were_seen(tmp_path):
    log = read(tmp_path / "trial.csv", section(HIPS | {"Subject:HEAD": [(9, 9, 9)] * 2, "box:1": [(5, 5, 5)] * 2}))
    assert log.people.select("person", "x_m", "y_m", "z_m").rows() == [
        ("Subject", pytest.approx(0.1), pytest.approx(0.1), pytest.approx(0.95)),
        ("Subject", pytest.approx(0.01), pytest.approx(0.1), pytest.approx(0.9)),
    ]
    assert (log.up, log.clock) == ("z", "relative")
    assert log.facts["not_people"] == "box"
    assert log.facts["markers_used"] == "Subject:LASI, Subject:RASI"


def test_time_is_the_frame_over_the_rate_of_line_two(tmp_path):
    log = read(tmp_path / "trial.csv", section(HIPS, rate=250, first=501))
    assert log.people["t_s"].to_list() == pytest.approx([2.0, 2.004])


@pytest.mark.parametrize(("unit", "metres"), [("mm", 1e-3), ("cm", 1e-2), ("m", 1.0)])
def test_lengths_come_in_the_unit_of_the_units_row(tmp_path, unit, metres):
    log = read(tmp_path / "trial.csv", section({"a:PELVIS": [(100, 0, 0)]}, unit=unit))
    assert log.people["x_m"].to_list() == [pytest.approx(100 * metres)]
    with pytest.raises(DamagedLog, match="'V'"):
        read(tmp_path / "trial.csv", section({"a:PELVIS": [(1, 0, 0)]}, unit="V"))


def test_semicolons_alone_do_not_make_a_comma_decimal(tmp_path):
    log = read(tmp_path / "trial.csv", section({"a:PELVIS": [(100.5, 0, 0)]}, mark=";"))
    assert log.people["x_m"].to_list() == [0.1005]


def test_german_locales_separate_by_semicolon_and_write_a_decimal_comma(tmp_path):
    log = read(tmp_path / "trial.csv", section({"a:PELVIS": [(100.5, 0, 0)]}, mark=";", decimal=","))
    assert log.people["x_m"].to_list() == [0.1005]


@pytest.mark.parametrize("blank", ["", ",,,,"])
def test_the_trajectories_are_found_among_other_sections(tmp_path, blank):
    devices = section({"EMG": [(1, 2, 3)] * 9}, title="Devices", rate=2000, unit="V")
    lines = [*devices, blank, *section(HIPS), blank, *section({"LHip": [(7, 7, 7)]}, title="Model Outputs"), ""]
    log = read(tmp_path / "trial.csv", lines)
    assert log.people["x_m"].to_list() == pytest.approx([0.1, 0.01])
    assert log.facts["sections"] == "Devices, Trajectories, Model Outputs"
    assert log.set_aside.is_empty()


def test_a_file_of_devices_alone_has_no_positions(tmp_path):
    with pytest.raises(DamagedLog, match=r"no positions.*Devices") as refusal:
        read(tmp_path / "trial.csv", section({"EMG": [(1, 2, 3)]}, title="Devices", unit="V"))
    assert "with trajectories" in refusal.value.cure


def test_the_cell_file_names_a_subject_a_marker_or_the_markers_that_count(tmp_path):
    lines = section(HIPS | {"box:1": [(500, 0, 0), (600, 0, 0)]})
    path = tmp_path / "trial.csv"
    assert read(path, lines, body="box").people["x_m"].to_list() == [0.5, 0.6]
    assert read(path, lines, body="RASI").people["x_m"].to_list() == [0.2, None]
    named = read(path, lines, map={"markers": ["Subject:LASI", "box:1"], "up": "y"})
    assert named.people["x_m"].to_list() == pytest.approx([0.25, 0.305])
    assert named.up == "y"
    with pytest.raises(LogError, match="'Subjekt'") as refusal:
        read(path, lines, body="Subjekt")
    assert refusal.value.nearest == "Subject"
    with pytest.raises(ConfigError, match="list of names"):
        read(path, lines, map={"markers": "LASI"})


def test_a_last_row_cut_while_being_written_is_set_aside(tmp_path):
    path = tmp_path / "trial.csv"
    path.write_bytes("\r\n".join(section(HIPS))[:-1].encode())
    log = ADAPTER.read(path, ReadOptions())
    assert log.people.height == 1
    assert log.set_aside["source_row"].to_list() == [7]


def test_numbers_beyond_the_earth_are_not_seen_and_do_not_overflow(tmp_path):
    log = read(tmp_path / "trial.csv", section({"a:PELVIS": [("1e308", 1, 1), (1, 1, 1)]}))
    assert log.people["x_m"].to_list() == [None, 0.001]


def test_damage_gives_what_is_whole_or_a_refusal(tmp_path):
    path = tmp_path / "trial.csv"
    read_damaged(ADAPTER, path, "\r\n".join([*section(HIPS), "", *section(HIPS, title="Joints")]).encode(), seed=2)


_LINE = st.sampled_from(["", "Trajectories", "100", ",,a:LASI,,", "Frame,Sub Frame,X,Y,Z", ",,mm,mm,mm", "1,0,1,2,3"])


@given(lines=st.lists(_LINE | st.text(alphabet=',;XYZ019.-e\t"', max_size=12), max_size=12))
def test_any_order_of_lines_is_read_or_refused(tmp_path_factory, lines):
    path = tmp_path_factory.getbasetemp() / "any_vicon.csv"
    path.write_text("\n".join(lines) + "\n")
    read_or_refuse(ADAPTER, path)


def test_the_markers_of_a_subject_are_the_joints_of_a_skeleton_on_request(tmp_path):
    lines = section(HIPS | {"Subject:*7": [(1, 1, 1)] * 2, "box:1": [(500, 0, 0), (600, 0, 0)]})
    log = read(tmp_path / "trial.csv", lines, skeletons=True)
    assert log.skeletons.rows() == [
        (0.0, "Subject", "lasi", 0.0, 0.1, 0.9, 6),
        (0.0, "Subject", "rasi", 0.2, 0.1, 1.0, 6),
        (0.01, "Subject", "lasi", 0.01, 0.1, 0.9, 7),
        (0.01, "Subject", "rasi", None, None, None, 7),
    ]


def test_a_blank_line_among_the_rows_ends_nothing(tmp_path):
    lines = section({"a:PELVIS": [(100, 0, 0), (200, 0, 0)]})
    log = read(tmp_path / "trial.csv", [*lines[:6], "", *lines[6:], "", "Model Outputs", "100", "LHipAngles"])
    assert log.people.select("x_m", "source_row").rows() == [(0.1, 6), (0.2, 8)]
    assert log.facts["sections"] == "Trajectories, Model Outputs"


def test_a_trial_with_events_on_top_is_read_as_well(tmp_path):
    events = ["Events", "100", "Subject,Context,Name,Time (s),Description", "Ann,Left,Foot Strike,0.51,", ""]
    log = read(tmp_path / "trial.csv", [*events, *section(HIPS)])
    assert log.people["x_m"].to_list() == pytest.approx([0.1, 0.01])
    assert log.people["source_row"].to_list() == [11, 12]


def test_a_second_section_of_trajectories_is_not_dropped_silently(tmp_path):
    lines = [*section(HIPS), "", *section(HIPS, first=3)]
    log = read(tmp_path / "trial.csv", lines)
    assert log.people["t_s"].to_list() == [0.0, 0.01]
    assert any("second section Trajectories" in said for said in log.warnings)
    assert not any("second section" in said for said in read(tmp_path / "trial.csv", section(HIPS)).warnings)


def objects(segments, *, title="Objects", axes="RX RY RZ TX TY TZ", angles="Global Angle ", first=31, unit="mm"):
    """Return the lines of a section of segments: their names stand over a rotation and a translation each."""
    axes = axes.split()
    turned = [name[0] == "R" for name in axes]
    lines = [title, "100", ",," + ",".join(f"{angles}{name}" + "," * (len(axes) - 1) for name in segments)]
    lines.append(",".join(["Frame,Sub Frame", *axes * len(segments)]))
    lines.append(",," + ",".join("rad" if turn else unit for _ in segments for turn in turned))
    for i in range(len(next(iter(segments.values())))):
        cells = [f"{first + i}", "0"]
        for track in segments.values():
            place = track[i] or ("", "", "")
            cells += ["0.5" if place[0] != "" else ""] * sum(turned) + [str(number) for number in place]
        lines.append(",".join(cells))
    return lines


BODY = {"collar:collar": [(1, 2, 1400), (1, 2, 1401)], "hip:hip": [(100, 200, 900), None]}


def test_the_segments_of_an_object_section_are_one_person_at_the_pelvis(tmp_path):
    log = read(tmp_path / "lift.csv", ["\ufeffObjects", *objects(BODY)[1:]], skeletons=True)
    assert log.people.rows() == [(0.3, "person", 0.1, 0.2, 0.9, 6), (0.31, "person", None, None, None, 7)]
    assert log.facts["point"] == "origin of the pelvis"
    assert (log.facts["section"], log.facts["names_in_file"]) == ("Objects", "collar, hip")
    assert log.skeletons.filter(log.skeletons["joint"] == "collar")["z_m"].to_list() == pytest.approx([1.4, 1.401])


@pytest.mark.parametrize(
    ("axes", "angles"),
    [
        ("RX RY RZ TX TY TZ", "Global Angle "),
        ("RX RY RZ RW TX TY TZ", "Global Angle (Quaternion) "),
        ("TX TY TZ", ""),
    ],
)
def test_the_translation_of_a_segment_is_found_behind_its_rotation(tmp_path, axes, angles):
    log = read(tmp_path / "lift.csv", objects(BODY, axes=axes, angles=angles, title="Segments"))
    assert log.people["x_m"].to_list() == [0.1, None]


def test_rotations_without_translations_are_no_positions(tmp_path):
    path = tmp_path / "lift.csv"
    path.write_text("\n".join(objects({"hip:hip": [()]}, axes="RX RY RZ")) + "\n")
    with pytest.raises(DamagedLog, match="lines 3 and 4: no positions") as refusal:
        ADAPTER.read(path, ReadOptions())
    assert "TX, TY, TZ" in refusal.value.cause


def test_objects_without_a_pelvis_are_bodies_of_their_own(tmp_path):
    lines = objects({"box:box": [(1000, 0, 0)], "helmet:helmet": [(2000, 0, 0)]})
    path = tmp_path / "cell.csv"
    assert read(path, lines).people.select("person", "x_m").rows() == [("box", 1.0), ("helmet", 2.0)]
    assert read(path, lines, body="helmet").people.select("person", "x_m").rows() == [("helmet", 2.0)]
    with pytest.raises(LogError, match="'helm'"):
        read(path, lines, body="helm")


def test_segments_of_several_subjects_are_people_by_subject(tmp_path):
    lines = objects({"Ann:Pelvis": [(1000, 0, 0)], "Ann:Head": [(9, 9, 9)], "Bo:Pelvis": [(2000, 0, 0)]})
    log = read(tmp_path / "cell.csv", lines)
    assert log.people.select("person", "x_m").rows() == [("Ann", 1.0), ("Bo", 2.0)]


def test_where_a_file_has_markers_and_objects_the_map_may_choose_the_objects(tmp_path):
    lines = [*objects(BODY), "", *section(HIPS)]
    path = tmp_path / "cell.csv"
    log = read(path, lines)
    assert (log.facts["section"], log.people["x_m"][0]) == ("Trajectories", pytest.approx(0.1))
    assert any('section = "Objects"' in said for said in log.warnings)
    log = read(path, lines, map={"section": "Objects"})
    assert log.people.select("x_m", "source_row").rows() == [(0.1, 6), (None, 7)]
    with pytest.raises(DamagedLog, match=r"none is Segments"):
        read(path, lines, map={"section": "Segments"})
    with pytest.raises(ConfigError, match="'Devices'"):
        read(path, lines, map={"section": "Devices"})


@pytest.mark.parametrize(
    ("line", "text", "said"),
    [
        (1, "fast", "line 2: no rate"),
        (2, ",,,,", "lines 3 and 4: no positions"),
        (4, ",,rad,rad,rad,mm,mm,mm,rad,rad,rad,cm,mm,mm", "line 5: unknown length unit 'cm, mm'"),
    ],
)
def test_a_broken_header_is_refused_with_its_lines(tmp_path, line, text, said):
    lines = objects(BODY)
    lines[line] = text
    path = tmp_path / "lift.csv"
    path.write_text("\n".join(lines) + "\n")
    with pytest.raises(DamagedLog, match=said):
        ADAPTER.read(path, ReadOptions())


def test_a_row_of_segments_that_was_cut_is_set_aside_with_its_line(tmp_path):
    path = tmp_path / "lift.csv"
    lines = objects(BODY)
    lines[5] = lines[5].rpartition(",")[0]
    path.write_text("\n".join(lines) + "\n")
    log = ADAPTER.read(path, ReadOptions())
    assert log.set_aside["source_row"].to_list() == [6]
    path.write_text("\n".join(lines[:4]))
    with pytest.raises(DamagedLog, match="line 1: the header of the section Objects is cut"):
        ADAPTER.read(path, ReadOptions())


def test_damaged_objects_give_what_is_whole_or_a_refusal(tmp_path):
    path = tmp_path / "lift.csv"
    read_damaged(ADAPTER, path, "\r\n".join([*objects(BODY), ""]).encode(), seed=5, cuts=10, flips=15)
