import pytest
from damage import read_damaged, read_or_refuse
from hypothesis import given
from hypothesis import strategies as st

from cyclekit.adapter import ReadOptions
from cyclekit.errors import DamagedLog, LogError
from cyclekit.ingest.registry import adapters
from cyclekit_adapters.formats.qualisys import ADAPTER

HIPS = {"WaistL": [(1000.0, 200.0, 950.0), (1010.0, 200.0, 950.0)], "WaistR": [(1000.0, 400.0, 950.0)] * 2}


def tsv(markers, *, rate="100", clock=True, titles=True, types=None, version=None, included="3D", seconds=None):
    """Return what QTM writes: the row of names ends with a tab, the data rows do not."""
    frames = len(next(iter(markers.values())))
    head = [f"FILE_VERSION\t{version}"] if version else []
    head += [f"NO_OF_FRAMES\t{frames}", "NO_OF_CAMERAS\t8", f"NO_OF_MARKERS\t{len(markers)}", f"FREQUENCY\t{rate}"]
    head += ["NO_OF_ANALOG\t0", "ANALOG_FREQUENCY\t0", "DESCRIPTION\t--"]
    head += ["TIME_STAMP\t2026-01-19, 10:19:43.755\t2063631.96175450", f"DATA_INCLUDED\t{included}"]
    head += ["\t".join(["MARKER_NAMES", *markers])]
    head += ["\t".join(["TRAJECTORY_TYPES", *(types or ["Measured"] * len(markers))])]
    if titles:
        lead = ["Frame", "Time"] if clock else []
        head.append("\t".join([*lead, *(f"{name} {axis}" for name in markers for axis in "XYZ")]) + "\t")
    for i in range(frames):
        lead = [str(i + 1), f"{(seconds[i] if seconds else i / 100):.5f}"] if clock else []
        cells = [("" if v is None else v if isinstance(v, str) else f"{v:.3f}") for t in markers.values() for v in t[i]]
        head.append("\t".join([*lead, *cells]))
    return "\r\n".join(head) + "\r\n"


def read(path, text, **options):
    path.write_bytes(text.encode())
    assert [name for name, entry in adapters().items() if entry.adapter.recognises(path)] == ["qualisys"]
    return ADAPTER.read(path, ReadOptions(**options))


@pytest.mark.parametrize("titles", [True, False])
@pytest.mark.parametrize("clock", [True, False])
@pytest.mark.parametrize("version", [None, "2.0.0"])
def test_the_person_is_the_middle_of_the_pelvis_markers(tmp_path, titles, clock, version):
    text = tsv(HIPS, titles=titles, clock=clock, version=version)
    log = read(tmp_path / "walk.tsv", text)
    last = len(text.splitlines())
    assert log.people.select("t_s", "x_m", "y_m", "z_m", "source_row").rows() == [
        pytest.approx((0.0, 1.0, 0.3, 0.95, last - 1)),
        pytest.approx((0.01, 1.005, 0.3, 0.95, last)),
    ]
    assert (log.up, log.clock) == ("z", "relative")
    assert log.set_aside.is_empty()


@pytest.mark.parametrize("missing", [(0.0, 0.0, 0.0), ("", "", ""), ("NULL", "NULL", "NULL")])
def test_a_marker_that_was_not_seen_is_unknown_and_not_the_origin(tmp_path, missing):
    log = read(tmp_path / "walk.tsv", tsv({"Pelvis": [missing, (0.0, 10.0, 900.0)]}))
    assert log.people["x_m"].to_list() == [None, 0.0]
    assert any("not seen in 1 of 2 frames" in said for said in log.warnings)


def test_an_external_timebase_has_no_rate_so_the_time_column_is_the_clock(tmp_path):
    log = read(tmp_path / "walk.tsv", tsv(HIPS, rate="EXT", seconds=[0.0, 0.04]))
    assert log.people["t_s"].to_list() == [0.0, 0.04]
    with pytest.raises(LogError, match="neither a frequency") as refusal:
        read(tmp_path / "walk.tsv", tsv(HIPS, rate="EXT", clock=False))
    assert "rate_hz" in refusal.value.cure
    given_rate = read(tmp_path / "walk.tsv", tsv(HIPS, rate="EXT", clock=False), rate_hz=50.0)
    assert given_rate.people["t_s"].to_list() == [0.0, 0.02]


def test_a_time_column_that_contradicts_the_frequency_wins_and_is_said(tmp_path):
    log = read(tmp_path / "walk.tsv", tsv(HIPS, seconds=[0.0, 0.5]))
    assert log.people["t_s"].to_list() == [0.0, 0.5]
    assert "the Time column is used" in log.warnings[0]


def test_nameless_markers_are_taken_together_and_that_is_said(tmp_path):
    log = read(tmp_path / "walk.tsv", tsv({"New 0000": [(0.0, 1.0, 2.0)], "New 0001": [(4.0, 5.0, 6.0)]}))
    assert log.people.select("x_m", "y_m", "z_m").rows() == [pytest.approx((0.002, 0.003, 0.004))]
    assert any("known pelvis name" in said for said in log.warnings)
    one = ADAPTER.read(tmp_path / "walk.tsv", ReadOptions(body="New 0001"))
    assert one.people["x_m"].to_list() == [0.004]


@pytest.mark.parametrize("titles", [True, False])
def test_a_locale_with_a_decimal_comma_is_read_alike(tmp_path, titles):
    head, _, body = tsv(HIPS, titles=titles, rate="100").partition("TRAJECTORY_TYPES")
    log = read(tmp_path / "walk.tsv", head + "TRAJECTORY_TYPES" + body.replace(".", ","))
    assert log.people.select("t_s", "x_m", "y_m", "z_m").rows()[1] == pytest.approx((0.01, 1.005, 0.3, 0.95))


def test_filled_trajectories_are_no_measurement_and_that_is_said(tmp_path):
    log = read(tmp_path / "walk.tsv", tsv(HIPS, types=["Measured", "Mixed"]))
    assert any("not measured: WaistR" in said for said in log.warnings)


BODY = ["X", "Y", "Z", "Roll", "Pitch", "Yaw", "Residual", *(f"Rot[{i}]" for i in range(9)), ""]


def bodies(places, *, titles=True, apart=True):
    """Return what QTM writes of rigid bodies: sixteen columns each and an empty one; the name stands before X."""
    columns = BODY if apart else BODY[:-1]
    frames = len(next(iter(places.values())))
    head = [f"NO_OF_FRAMES\t{frames}", "NO_OF_CAMERAS\t4", f"NO_OF_BODIES\t{len(places)}", "FREQUENCY\t100"]
    head += ["DATA_INCLUDED\t6D", "\t".join(["BODY_NAMES", *places])]
    if titles:
        head.append("\t".join(["Frame", "Time", *(t for n in places for t in [f"{n} X", *columns[1:]])]))
    for i in range(frames):
        cells = [c for track in places.values() for c in [*map(str, track[i]), *["0.5"] * 13, *columns[16:]]]
        head.append("\t".join([str(i + 1), f"{i / 100:.5f}", *cells]))
    return "\r\n".join(head) + "\r\n"


@pytest.mark.parametrize("apart", [True, False])
def test_rigid_bodies_are_people_by_their_names_at_their_origin(tmp_path, apart):
    text = bodies({"helmet": [(1000.0, 200.0, 1700.0), (0, 0, 0)], "box": [(5, 5, 5), ("", "", "")]}, apart=apart)
    log = read(tmp_path / "walk.tsv", text)
    assert log.people.select("t_s", "person", "x_m", "y_m", "z_m").rows() == [
        (0.0, "helmet", 1.0, 0.2, 1.7),
        (0.0, "box", 0.005, 0.005, 0.005),
        (0.01, "helmet", None, None, None),
        (0.01, "box", None, None, None),
    ]
    assert any("2 bodies tracked" in said for said in log.warnings)
    assert log.facts["point"] == "origin of the rigid body"
    assert read(tmp_path / "walk.tsv", text, body="box").people["x_m"].to_list() == [0.005, None]
    with_flange = read(tmp_path / "walk.tsv", text, body="helmet", flange="box")
    assert sorted(set(with_flange.people["person"])) == ["box", "helmet"]
    assert not any("bodies tracked" in said or "'box'" in said for said in with_flange.warnings)
    with pytest.raises(LogError, match="'helm'") as refusal:
        read(tmp_path / "walk.tsv", text, body="helm")
    assert refusal.value.nearest == "helmet"


def test_rigid_bodies_without_column_names_and_skeletons_are_refused(tmp_path):
    with pytest.raises(DamagedLog, match="no columns X, Y, Z of the body 'helmet'"):
        read(tmp_path / "walk.tsv", bodies({"helmet": [(1, 2, 3)]}, titles=False))
    with pytest.raises(DamagedLog, match="holds SKELETON data"):
        read(tmp_path / "walk.tsv", tsv(HIPS, included="SKELETON"))


def test_a_first_row_that_begins_with_a_gap_is_no_row_of_column_names(tmp_path):
    log = read(tmp_path / "walk.tsv", tsv({"A": [("", "", "")], "Pelvis": [(1, 2, 3)]}, titles=False, clock=False))
    assert log.people["x_m"].to_list() == [0.001]


def test_the_labelled_markers_of_a_subject_are_the_joints_of_a_skeleton_on_request(tmp_path):
    markers = {"Ann:LASI": [(1000.0, 0, 900)], "Ann:Head": [(0, 0, 0)], "box:1": [(9.0, 9, 9)]}
    log = read(tmp_path / "walk.tsv", tsv(markers), skeletons=True)
    last = len(tsv(markers).splitlines())
    assert log.skeletons.rows() == [
        (0.0, "Ann", "lasi", 1.0, 0.0, 0.9, last),
        (0.0, "Ann", "head", None, None, None, last),
    ]
    assert read(tmp_path / "walk.tsv", tsv(markers)).skeletons is None


def test_rows_that_do_not_fit_the_markers_are_refused_where_no_names_tell_the_columns(tmp_path):
    text = tsv(HIPS, titles=False, clock=False).replace("\r\n1000.000\t", "\r\n7\t1000.000\t")
    with pytest.raises(DamagedLog, match="rows of 7 fields"):
        read(tmp_path / "walk.tsv", text)


def test_a_last_row_cut_while_being_written_is_set_aside(tmp_path):
    log = read(tmp_path / "walk.tsv", tsv(HIPS)[:-5])
    assert log.people.height == 1
    assert log.set_aside["source_row"].to_list() == [len(tsv(HIPS).splitlines())]


def test_damage_gives_what_is_whole_or_a_refusal(tmp_path):
    path = tmp_path / "walk.tsv"
    read_damaged(ADAPTER, path, tsv(HIPS).encode(), seed=3)


_LINE = st.sampled_from(tsv(HIPS).splitlines())


@given(lines=st.lists(_LINE | st.text(alphabet="\t019.-eXNFrame", max_size=12), max_size=15))
def test_any_order_of_lines_is_read_or_refused(tmp_path_factory, lines):
    path = tmp_path_factory.getbasetemp() / "any_qtm.tsv"
    path.write_text("\n".join(lines) + "\n")
    read_or_refuse(ADAPTER, path)


def test_events_set_in_qtm_are_events_at_the_time_of_their_frame(tmp_path):
    lines = tsv(HIPS).split("\r\n")
    lines[8:8] = ["EVENT\tsync\t1\t0.00000", "EVENT\tsync\t151\t1.50000"]
    log = read(tmp_path / "walk.tsv", "\r\n".join(lines))
    assert log.events.rows() == [(0.0, "sync", "frame 1", 9), (1.5, "sync", "frame 151", 10)]
    assert log.people["x_m"].to_list() == pytest.approx([1.0, 1.005])
    external = "\r\n".join(lines).replace("FREQUENCY\t100", "FREQUENCY\tEXT").replace("\t1.50000", "\t1,75")
    assert read(tmp_path / "walk.tsv", external).events["t_s"].to_list() == [0.0, 1.75]
    assert read(tmp_path / "walk.tsv", tsv(HIPS)).events is None


def test_keys_in_another_order_and_keys_of_a_later_version_are_no_obstacle(tmp_path):
    lines = tsv(HIPS).split("\r\n")
    stamp = next(i for i, line in enumerate(lines) if line.startswith("TIME_STAMP"))
    moved = [lines[stamp], *lines[:stamp], "CAPTURE_VOLUME\t1\t2", *lines[stamp + 1 :]]
    log = read(tmp_path / "walk.tsv", "\r\n".join(moved))
    assert log.people["x_m"].to_list() == pytest.approx([1.0, 1.005])
    assert log.people["source_row"].to_list() == [14, 15]
