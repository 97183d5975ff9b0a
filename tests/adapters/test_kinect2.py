import pytest
from damage import read_damaged, read_or_refuse
from hypothesis import given
from hypothesis import strategies as st

from cyclekit.adapter import ReadOptions
from cyclekit.errors import DamagedLog, LogError
from cyclekit.ingest.registry import adapters
from cyclekit_adapters.formats.kinect2 import ADAPTER


def row(ticks, x, y=-0.5, z=2.0, state=2, end=","):
    """Return ticks and 25 joints, the base of the spine first, with the recorder's comma at the end."""
    rest = [f"{0.1 * i:g},{0.01 * i:g},2.5,{i % 3}" for i in range(1, 25)]
    return ",".join([str(ticks), f"{x},{y},{z},{state}", *rest]) + end


def read(path, rows, **options):
    path.write_text("\n".join(rows) + "\n")
    assert [name for name, entry in adapters().items() if entry.adapter.recognises(path)] == ["kinect2"]
    return ADAPTER.read(path, ReadOptions(**options))


@pytest.mark.parametrize("end", [",", ""])
def test_the_base_of_the_spine_in_metres_at_ticks_of_100_ns(tmp_path, end):
    log = read(tmp_path / "joints.csv", [row(31867373716, 0.25, end=end), row(31867714704, 0.5, end=end)])
    assert log.people.rows() == [
        (pytest.approx(3186.7373716), "1", 0.25, -0.5, 2.0, 1),
        (pytest.approx(3186.7714704), "1", 0.5, -0.5, 2.0, 2),
    ]
    assert (log.up, log.clock, log.rows_are) == ("y", "uptime", "line")


def test_an_untracked_joint_is_unknown_and_an_inferred_one_is_used_and_counted(tmp_path):
    log = read(tmp_path / "joints.csv", [row(10, 0.25, state=0), row(20, 0.5, state=1), row(30, 0.75)])
    assert log.people["x_m"].to_list() == [None, 0.5, 0.75]
    assert any("inferred, not seen, in 1 of 3 rows" in said for said in log.warnings)
    assert any("not tracked in 1 of 3 rows" in said for said in log.warnings)


def test_bodies_that_share_a_time_are_linked_by_motion(tmp_path):
    rows = [row(i * 333_333, x) for i in range(3) for x in ((0.0, 2.0) if i != 1 else (2.0, 0.0))]
    log = read(tmp_path / "joints.csv", rows)
    tracks = sorted(part["x_m"].to_list() for _, part in log.people.group_by("person"))
    assert tracks == [[0.0] * 3, [2.0] * 3]
    assert any("linked by motion" in said for said in log.warnings)
    assert read(tmp_path / "joints.csv", rows, body="1").people.height == 3
    with pytest.raises(LogError, match="no body '7'"):
        read(tmp_path / "joints.csv", rows, body="7")


def test_more_rows_of_one_time_than_the_sensor_tracks_bodies_are_refused(tmp_path):
    """All rows of one time had to be held to the end, so memory grew with the file."""
    six = [row(i * 333_333, 0.4 * body) for i in range(3) for body in range(6)]
    assert read(tmp_path / "joints.csv", six).people["person"].n_unique() == 6
    again = [row(i % 6 * 333_333, 0.4) for i in range(30)]  # the sensor began again, and again
    assert read(tmp_path / "joints.csv", again).people.height == 30
    rounded = [row(10 + i // 9, 0.1) for i in range(36)]
    with pytest.raises(DamagedLog, match="line 7: more than 6 rows in a row have one time") as refusal:
        read(tmp_path / "joints.csv", rounded)
    assert "rounded" in str(refusal.value)


@pytest.mark.parametrize(
    "other", ["1,2,3,4", row(10, 0.5, state=3), row("time", 0.5), row(10, "left"), ",".join(["1"] * 77)]
)
def test_other_tables_are_not_recognised(tmp_path, other):
    path = tmp_path / "a.csv"
    path.write_text(other + "\n")
    assert not ADAPTER.recognises(path)


def test_a_last_row_cut_while_being_written_is_set_aside(tmp_path):
    path = tmp_path / "joints.csv"
    path.write_text(row(10, 0.25) + "\n" + row(20, 0.5)[:-30])
    log = ADAPTER.read(path, ReadOptions())
    assert log.people["x_m"].to_list() == [0.25]
    assert log.set_aside["source_row"].to_list() == [2]


def test_rows_that_cannot_be_used_at_all_are_refused(tmp_path):
    path = tmp_path / "joints.csv"
    path.write_text(row("ten", 0.25) + "\n")
    with pytest.raises(DamagedLog, match="none of its first rows"):
        ADAPTER.read(path, ReadOptions())
    path.write_text(row(10, 0.25))
    with pytest.raises(DamagedLog, match="none of its"):
        ADAPTER.read(path, ReadOptions())


def test_damage_gives_what_is_whole_or_a_refusal(tmp_path):
    path = tmp_path / "joints.csv"
    read_damaged(ADAPTER, path, "\n".join([row(10, 0.25), row(20, 0.5), row(20, 0.75), ""]).encode(), seed=6)


@given(cells=st.lists(st.sampled_from(["0", "1", "2", "1e308", "-1", "nan", "x", ""]), min_size=95, max_size=105))
def test_any_cells_are_read_or_refused(tmp_path_factory, cells):
    path = tmp_path_factory.getbasetemp() / "any_kinect2.csv"
    path.write_text((",".join(cells) + "\n") * 3)
    read_or_refuse(ADAPTER, path)


def test_the_joints_are_those_of_the_sdk_on_request(tmp_path):
    log = read(tmp_path / "joints.csv", [row(10_000_000, 0.25), row(20_000_000, 0.5)], skeletons=True)
    assert log.skeletons.height == 50
    assert log.skeletons.row(0) == (1.0, "1", "spinebase", 0.25, -0.5, 2.0, 1)
    assert log.skeletons.row(1) == (1.0, "1", "spinemid", 0.1, 0.01, 2.5, 1)
    assert log.skeletons.row(3) == (1.0, "1", "head", None, None, None, 1)  # state 0
    assert log.skeletons.row(24)[2] == "thumbright"
    assert log.skeletons.row(49) == (2.0, "1", "thumbright", None, None, None, 2)


def test_until_two_bodies_share_a_time_there_is_one_person_who_keeps_the_name(tmp_path):
    rows = [row(10, 0.0), row(333_333, 0.1), row(666_666, 2.0), row(666_666, 0.2), row(999_999, 0.3)]
    log = read(tmp_path / "joints.csv", rows)
    assert log.people.select("person", "x_m").rows() == [("1", 0.0), ("1", 0.1), ("2", 2.0), ("1", 0.2), ("1", 0.3)]
