import pytest
from damage import read_damaged, read_or_refuse
from hypothesis import given
from hypothesis import strategies as st

from cyclekit.adapter import ReadOptions
from cyclekit.errors import ConfigError, DamagedLog, LogError
from cyclekit.ingest.registry import adapters
from cyclekit_adapters.formats.trc import ADAPTER

KEYS = [
    "DataRate",
    "CameraRate",
    "NumFrames",
    "NumMarkers",
    "Units",
    "OrigDataRate",
    "OrigDataStartFrame",
    "OrigNumFrames",
]
HALPE = {
    "RHip": [(0.1, 0.9, -1.0), (0.2, 0.9, -1.0)],
    "LHip": [(-0.1, 1.0, -1.0), None],
    "Head": [(0.0, 1.7, -1.0), (0.0, 1.7, -1.0)],
    "LHeel": [(0.0, 0.05, -1.0), (0.0, 0.05, -1.0)],
}
BLANK = ("", "", "")


def lines_of(markers, *, unit="m", rate=50, first=1, zero=0.0, blank_line=False, tail="", stated=None, mark="\t"):
    """Return the lines of a TRC file: OpenSim's with a blank line and a tab behind each row, or Pose2Sim's."""
    frames = len(next(iter(markers.values())))
    values = [rate, rate, stated or frames, len(markers), unit, rate, first, frames]
    lines = [mark.join(["PathFileType", "4", "(X/Y/Z)", "walk.trc"]), mark.join(KEYS), mark.join(map(str, values))]
    lines.append(mark.join(["Frame#", "Time", *(cell for name in markers for cell in (name, "", ""))]))
    axes = [f"{axis}{i}" for i in range(1, len(markers) + 1) for axis in "XYZ"]
    lines.append(mark.join(["", "", *axes]) + tail)
    lines += [""] * blank_line
    for i in range(frames):
        cells = [str(number) for track in markers.values() for number in track[i] or BLANK]
        lines.append(mark.join([str(first + i), f"{zero + i / rate:.6f}", *cells]) + tail)
    return lines


def read(path, lines, **options):
    path.write_bytes(("\n".join(lines) + "\n").encode())
    assert [name for name, entry in adapters().items() if entry.adapter.recognises(path)] == ["trc"]
    return ADAPTER.read(path, ReadOptions(**options))


def test_the_person_is_the_middle_of_the_hips_seen_and_y_is_up(tmp_path):
    log = read(tmp_path / "walk.trc", lines_of(HALPE))
    assert log.people.rows() == [
        (0.0, "person", pytest.approx(0.0), pytest.approx(0.95), -1.0, 6),
        (0.02, "person", 0.2, 0.9, -1.0, 7),
    ]
    assert (log.up, log.clock) == ("y", "relative")
    assert log.facts["up"] == "y, since heads are above feet"
    assert log.facts["markers_used"] == "RHip, LHip"


def test_a_file_of_opensim_with_blank_line_and_tabs_behind_its_rows_is_the_same(tmp_path):
    log = read(tmp_path / "walk.trc", lines_of(HALPE, blank_line=True, tail="\t"))
    assert log.people["x_m"].to_list() == pytest.approx([0.0, 0.2])
    assert log.people["source_row"].to_list() == [7, 8]
    assert log.set_aside.is_empty()


@pytest.mark.parametrize(("unit", "metres"), [("mm", 1e-3), ("m", 1.0), ("cm", 1e-2), ("meters", 1.0), ("MM", 1e-3)])
def test_lengths_come_in_the_unit_of_the_header(tmp_path, unit, metres):
    log = read(tmp_path / "walk.trc", lines_of({"L.ASIS": [(100, 0, 0)]}, unit=unit))
    assert log.people["x_m"].to_list() == [pytest.approx(100 * metres)]


def test_time_is_exact_where_the_time_column_is_rounded_and_keeps_its_zero(tmp_path):
    lines = lines_of({"Pelvis": [(1, 1, 1)] * 90}, rate=60, first=31, zero=0.5)
    for i in range(5, len(lines)):
        frame, time, rest = lines[i].split("\t", 2)
        lines[i] = "\t".join([frame, f"{float(time):.3f}", rest])
    log = read(tmp_path / "walk.trc", lines)
    assert log.people["t_s"].to_list() == pytest.approx([0.5 + i / 60 for i in range(90)], abs=1e-12)
    assert log.warnings == ()


def test_where_rate_and_time_contradict_each_other_the_time_column_is_used(tmp_path):
    lines = lines_of({"Pelvis": [(1, 1, 1)] * 5}, rate=100)
    log = read(tmp_path / "walk.trc", [line.replace("100\t100", "30\t30") for line in lines])
    assert log.people["t_s"].to_list() == pytest.approx([0.0, 0.01, 0.02, 0.03, 0.04])
    assert any("does not fit the Time column" in said for said in log.warnings)


@pytest.mark.parametrize("gap", [BLANK, ("NaN", "NaN", "NaN"), ("nan", "nan", "nan"), (0, 0, 0), (" ", " ", " ")])
def test_a_gap_is_not_seen(tmp_path, gap):
    log = read(tmp_path / "walk.trc", lines_of({"Pelvis": [(1, 1, 1), gap]}))
    assert log.people["x_m"].to_list() == [1.0, None]


def test_a_file_that_was_not_turned_to_y_up_is_seen_by_heads_and_feet(tmp_path):
    turned = {name: [place and (place[0], -place[2], place[1]) for place in track] for name, track in HALPE.items()}
    path = tmp_path / "walk.trc"
    log = read(path, lines_of(turned))
    assert (log.up, log.facts["up"]) == ("z", "z, since heads are above feet")
    told = read(path, lines_of(turned), map={"up": "y"})
    assert (told.up, told.facts["up"]) == ("y", "y, from the cell file")
    with pytest.raises(ConfigError, match="'x'"):
        read(path, lines_of(turned), map={"up": "x"})


def test_without_heads_and_feet_y_is_up_as_opensim_has_it(tmp_path):
    log = read(tmp_path / "walk.trc", lines_of({"Pelvis": [(1, 1, 1)]}))
    assert (log.up, log.facts["up"]) == ("y", "y, the default of OpenSim; not in the file")


def test_garbled_numbers_tell_nothing_of_up_and_do_not_overflow(tmp_path):
    garbled = HALPE | {"Head": [("1e308", "-1e308", 1), ("1e308", 1, 1)], "Nose": [("1e308", 1, 1)] * 2}
    log = read(tmp_path / "walk.trc", lines_of(garbled))
    assert log.facts["up"] == "y, the default of OpenSim; not in the file"


def test_heads_below_feet_are_said(tmp_path):
    upside_down = {
        name: [place and (place[0], -place[1], place[2]) for place in track] for name, track in HALPE.items()
    }
    log = read(tmp_path / "walk.trc", lines_of(upside_down))
    assert any("heads are not above feet" in said for said in log.warnings)


def test_keypoints_around_the_persons_own_hips_are_refused(tmp_path):
    hips = {"RHip": [(0.1, 0.001, 0.05)] * 12, "LHip": [(-0.1, -0.001, -0.05)] * 12, "Nose": [(0, 0.6, 0)] * 12}
    with pytest.raises(LogError, match="relative to the person's hips"):
        read(tmp_path / "walk.trc", lines_of(hips))


def test_the_cell_file_names_a_marker_or_the_markers_that_count(tmp_path):
    path = tmp_path / "walk.trc"
    assert read(path, lines_of(HALPE), body="Head").people["y_m"].to_list() == [1.7, 1.7]
    named = read(path, lines_of(HALPE), map={"markers": ["Head", "LHeel"]})
    assert named.people["y_m"].to_list() == pytest.approx([0.875, 0.875])


def test_the_markers_are_the_joints_of_a_skeleton_on_request(tmp_path):
    log = read(tmp_path / "walk.trc", lines_of(HALPE), skeletons=True)
    assert log.skeletons.filter(log.skeletons["joint"] == "lhip").select("t_s", "x_m").rows() == [
        (0.0, -0.1),
        (0.02, None),
    ]


def test_names_with_blanks_and_rows_with_decimal_commas_are_read(tmp_path):
    lines = lines_of({"r asis": [(0.5, 1, 1)], "l asis": [(0.7, 1, 1)]})
    log = read(tmp_path / "walk.trc", [*lines[:5], lines[5].replace(".", ",")])
    assert log.people["x_m"].to_list() == [pytest.approx(0.6)]


def test_a_file_with_blanks_in_place_of_tabs_is_read(tmp_path):
    lines = [" ".join(line.split()) for line in lines_of({"Pelvis": [(1.5, 1, 1), (1.6, 1, 1)]})]
    assert read(tmp_path / "walk.trc", lines).people["x_m"].to_list() == [1.5, 1.6]


@pytest.mark.parametrize(
    ("line", "text", "said"),
    [
        (1, "a\tb", "line 2: no DataRate"),
        (2, "50\t50", "line 3: 2 values where line 2 names 8"),
        (2, "50\t50\t2\t4\tfurlong\t50\t1\t2", "line 3: unknown length unit 'furlong'"),
        (3, "Number\tTime\tRHip", "line 4: no Frame#"),
        (3, "Frame#\tTime\tRHip\t\t\tLHip", "line 5: 12 axes where the 2 names in line 4 need 6"),
        (4, "\t\tX1\tY1\tZ1", "line 5: 3 axes where the 4 names in line 4 need 12"),
        (5, "1\t0.0" + "\t1.0" * 13, "line 6: 15 fields where the 4 names in line 4 need 14"),
    ],
)
def test_a_header_that_does_not_fit_is_refused_with_its_line(tmp_path, line, text, said):
    lines = lines_of(HALPE)
    lines[line] = text
    path = tmp_path / "walk.trc"
    path.write_text("\n".join(lines) + "\n")
    with pytest.raises(DamagedLog, match=said):
        ADAPTER.read(path, ReadOptions())


@pytest.mark.parametrize("kept", [1, 2, 3, 4])
def test_a_file_cut_in_its_header_is_refused(tmp_path, kept):
    path = tmp_path / "walk.trc"
    path.write_text("\n".join(lines_of(HALPE)[:kept]))
    with pytest.raises(DamagedLog, match=rf"line [1{kept}]"):
        ADAPTER.read(path, ReadOptions())


def test_rows_that_are_cut_or_too_short_are_set_aside_with_their_lines(tmp_path):
    lines = lines_of({"Pelvis": [(1, 1, 1)] * 4}, stated=6)
    lines[6] = lines[6].rpartition("\t")[0]
    path = tmp_path / "walk.trc"
    path.write_text("\n".join(lines))
    log = ADAPTER.read(path, ReadOptions())
    assert log.people["source_row"].to_list() == [6, 8]
    assert log.set_aside["source_row"].to_list() == [7, 9]
    assert any("line 3 states 6 frames" in said for said in log.warnings)


@pytest.mark.parametrize("tail", ["", "\t"])
def test_damage_gives_what_is_whole_or_a_refusal(tmp_path, tail):
    path = tmp_path / "walk.trc"
    markers = {name: track * 4 for name, track in HALPE.items()}
    text = "\n".join([*lines_of(markers, tail=tail, blank_line=bool(tail)), ""])
    read_damaged(ADAPTER, path, text.encode(), seed=4, cuts=12, flips=16)


_LINE = st.sampled_from([*lines_of(HALPE), "", "Frame#\tTime\tPelvis", "\t\tX1\tY1\tZ1", "1\t0.02\t1\t2\t3"])


@given(lines=st.lists(_LINE | st.text(alphabet="\t ,019.-eXYZ#", max_size=12), max_size=10), head=st.integers(0, 5))
def test_any_order_of_lines_is_read_or_refused(tmp_path_factory, lines, head):
    path = tmp_path_factory.getbasetemp() / "any.trc"
    path.write_text("\n".join([*lines_of(HALPE)[:head], *lines]) + "\n")
    read_or_refuse(ADAPTER, path)


_NUMBER = st.floats(-50, 50).map(lambda number: round(number, 4)).filter(bool)


@given(
    places=st.lists(st.none() | st.tuples(_NUMBER, _NUMBER, _NUMBER), min_size=1, max_size=12),
    rate=st.sampled_from([25, 30, 59.94, 100, 240]),
    unit=st.sampled_from(["mm", "m"]),
    first=st.integers(0, 500),
)
def test_what_was_written_is_what_is_read(tmp_path_factory, places, rate, unit, first):
    path = tmp_path_factory.getbasetemp() / "any_places.trc"
    lines = lines_of({"Pelvis": [*places, (1, 1, 1)]}, rate=rate, unit=unit, first=first, zero=first / rate)
    path.write_text("\n".join(lines) + "\n")
    people = ADAPTER.read(path, ReadOptions()).people
    metres = {"mm": 1e-3, "m": 1.0}[unit]
    assert people["t_s"].to_list() == pytest.approx([(first + i) / rate for i in range(len(places) + 1)], abs=2e-6)
    read_back = people.select("x_m", "y_m", "z_m").rows()[:-1]
    assert [row[0] is None for row in read_back] == [place is None for place in places]
    for row, place in zip(read_back, places, strict=True):
        if place:
            assert row == pytest.approx(tuple(metres * number for number in place))
