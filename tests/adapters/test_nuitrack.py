import pytest
from damage import read_damaged, read_or_refuse
from hypothesis import given
from hypothesis import strategies as st

from cyclekit.adapter import ReadOptions
from cyclekit.errors import LogError, MissingColumns
from cyclekit.ingest.registry import adapters
from cyclekit_adapters.formats.nuitrack import ADAPTER

COLUMNS = ["timestamp", "serial", "id"]
WAIST = ["JOINT_WAIST.x", "JOINT_WAIST.y", "JOINT_WAIST.z"]
TORSO = ["JOINT_TORSO.x", "JOINT_TORSO.y", "JOINT_TORSO.z", "JOINT_TORSO.rot"]
START_US = 1715151474879921


def table(rows, columns=(*COLUMNS, *WAIST, *TORSO)):
    return "\n".join([",".join(columns), *(",".join(map(str, row)) for row in rows)]) + "\n"


def row(after_us, x, who=1, serial="CAM1", torso=9.0):
    return [START_US + after_us, serial, who, x, 0.9, 2.0, torso, 1.2, 2.0, 15.0]


def read(path, text, **options):
    path.write_text(text)
    assert [name for name, entry in adapters().items() if entry.adapter.recognises(path)] == ["nuitrack"]
    return ADAPTER.read(path, ReadOptions(**options))


def test_the_waist_in_metres_at_microseconds_since_1970(tmp_path):
    log = read(tmp_path / "nui.csv", table([row(0, 0.25), row(33_333, 0.5)]))
    assert log.people.select("person", "x_m", "y_m", "z_m", "source_row").rows() == [
        ("1", 0.25, 0.9, 2.0, 2),
        ("1", 0.5, 0.9, 2.0, 3),
    ]
    assert log.people["t_s"].to_list() == pytest.approx([START_US / 1e6, START_US / 1e6 + 0.033333], abs=1e-6)
    assert (log.clock, log.up) == ("epoch", "y")


def test_rows_that_the_recorder_wrote_again_count_once(tmp_path):
    log = read(tmp_path / "nui.csv", table([row(0, 0.25), row(0, 0.25), row(33_333, 0.5)]))
    assert log.people["x_m"].to_list() == [0.25, 0.5]
    assert log.set_aside.rows() == [(3, "repeats the time and id of a row before it")]


def test_a_small_timestamp_is_the_devices_own(tmp_path):
    log = read(tmp_path / "nui.csv", table([[500_000, "CAM1", 1, 0.1, 0.9, 2.0, 0, 0, 0, 0]]))
    assert (log.clock, log.people["t_s"].to_list()) == ("uptime", [0.5])


def test_where_the_waist_was_not_seen_the_torso_stands_for_it(tmp_path):
    lost = row(0, "", torso=0.75)
    log = read(tmp_path / "nui.csv", table([lost]))
    assert log.people.select("x_m", "y_m").rows() == [(0.75, 1.2)]


def test_a_leading_column_without_a_name_does_no_harm(tmp_path):
    log = read(tmp_path / "nui.csv", table([[0, *row(0, 0.25)]], columns=("", *COLUMNS, *WAIST, *TORSO)))
    assert log.people["x_m"].to_list() == [0.25]


def test_two_cameras_see_in_two_frames_and_that_is_said(tmp_path):
    log = read(tmp_path / "nui.csv", table([row(0, 0.25), row(0, 0.5, serial="CAM2")]))
    assert sorted(log.people["person"].to_list()) == ["CAM1/1", "CAM2/1"]
    assert any("2 cameras" in said for said in log.warnings)
    one = read(tmp_path / "nui.csv", table([row(0, 0.25), row(0, 0.5, serial="CAM2")]), body="CAM2/1")
    assert one.people["x_m"].to_list() == [0.5]
    with pytest.raises(LogError, match="no body"):
        read(tmp_path / "nui.csv", table([row(0, 0.25)]), body="9")


def test_a_table_without_ids_is_refused_by_name(tmp_path):
    with pytest.raises(MissingColumns, match="'id'"):
        read(tmp_path / "nui.csv", table([[START_US, 0.1, 0.2, 0.3]], columns=("timestamp", *WAIST)))


def test_damage_gives_what_is_whole_or_a_refusal(tmp_path):
    path = tmp_path / "nui.csv"
    read_damaged(ADAPTER, path, table([row(0, 0.25), row(0, 0.25), row(33_333, 0.5)]).encode(), seed=7)


@given(cells=st.lists(st.sampled_from(["0", "1", "1e308", "-1", "nan", "x", "", '"']), min_size=8, max_size=12))
def test_any_cells_are_read_or_refused(tmp_path_factory, cells):
    path = tmp_path_factory.getbasetemp() / "any_nui.csv"
    path.write_text(table([cells, cells]))
    read_or_refuse(ADAPTER, path)


def test_every_joint_of_the_recorder_on_request(tmp_path):
    log = read(tmp_path / "nui.csv", table([row(0, 0.25), row(0, 0.5, who=2, torso="")]), skeletons=True)
    assert log.skeletons.select("person", "joint", "x_m", "y_m", "z_m", "source_row").rows() == [
        ("1", "waist", 0.25, 0.9, 2.0, 2),
        ("1", "torso", 9.0, 1.2, 2.0, 2),
        ("2", "waist", 0.5, 0.9, 2.0, 3),
        ("2", "torso", None, None, None, 3),
    ]
    assert set(
        read(tmp_path / "nui.csv", table([row(0, 1), row(0, 2, who=2)]), skeletons=True, body="2").skeletons["person"]
    ) == {"2"}


def test_a_camera_that_joins_late_has_names_of_its_own(tmp_path):
    rows = [row(33_333 * i, 0.25) for i in range(400)] + [row(33_333 * 400, 0.5, serial="CAM2")]
    log = read(tmp_path / "nui.csv", table(rows))
    assert dict(log.people["person"].value_counts().rows()) == {"1": 400, "CAM2/1": 1}
    assert any("2 cameras" in said for said in log.warnings)


def test_a_joint_where_the_camera_is_was_not_seen(tmp_path):
    lost, torso = row(33_333, 0.0), row(66_666, 0.0)
    lost[3:9] = [0.0] * 6
    torso[3:6] = [0.0] * 3
    text = table([row(0, 0.25), lost, torso])
    log = read(tmp_path / "nui.csv", text, skeletons=True)
    assert log.people["x_m"].to_list() == [0.25, None, 9.0]
    assert log.skeletons.filter(joint="waist")["x_m"].to_list() == [0.25, None, None]
    assert any("no position in 1 of 3 rows" in said for said in log.warnings)
