import pytest

from cyclekit.adapter import ReadOptions
from cyclekit.errors import DamagedLog, LogError, MissingColumns, UnknownName
from cyclekit.ingest.validate.validate import examined
from cyclekit.schema import ROBOT
from cyclekit_adapters.formats.ur_rtde import ADAPTER


def read(path, **options):
    return ADAPTER.read(path, ReadOptions(**options))


def write(path, text, encoding="utf-8"):
    path.write_bytes(text.encode(encoding))
    return path


def test_the_scaling_is_the_product_of_limiter_and_slider_while_the_program_plays(tmp_path, ur):
    rows = [ur.row(10.0, speed_scaling=0.5, target_speed_fraction=0.8)]
    log = read(write(tmp_path / "run.csv", ur.text(rows)))
    assert log.robot["scaling"].to_list() == [0.4]
    assert log.robot["slider"].to_list() == [0.8]
    assert log.clock == "uptime"
    assert log.robot.columns[: len(ROBOT)] == list(ROBOT)


@pytest.mark.parametrize(
    ("runtime_state", "state"), [(0, "stopped"), (1, "stopped"), (3, "paused"), (4, "paused"), (5, "paused"), (9, None)]
)
def test_outside_of_playing_the_scaling_is_unknown_and_not_zero(tmp_path, ur, runtime_state, state):
    rows = [ur.row(10.0, speed_scaling=0.0, runtime_state=runtime_state), ur.row(10.1)]
    robot = read(write(tmp_path / "run.csv", ur.text(rows))).robot
    assert robot["scaling"].to_list() == [None, 1.0]
    assert robot["state"].to_list() == [state, "playing"]


@pytest.mark.parametrize("delimiter", [" ", ",", ";", "\t"])
def test_both_writers_and_their_edited_kin_give_the_same_table(tmp_path, ur, delimiter):
    rows = [ur.row(10.0 + i / 8, actual_TCP_pose_0=i, actual_q_5=-i) for i in range(4)]
    path = write(tmp_path / "run.csv", ur.text(rows, delimiter))
    assert ADAPTER.recognises(path)
    robot = read(path).robot
    assert robot["t_s"].to_list() == [10.0, 10.125, 10.25, 10.375]
    assert robot["tcp_x_m"].to_list() == [0, 1, 2, 3]
    assert robot["q5_rad"].to_list() == [0, -1, -2, -3]


def with_times(ur, times, delimiter=","):
    """A log of the PC's times where RTDE has the controller's."""
    lines = ur.text([ur.row(float(i), actual_TCP_pose_0=i) for i in range(len(times))], delimiter, "\n").splitlines()
    at = lines[0].split(delimiter).index("timestamp")
    out = [lines[0]]
    for line, time in zip(lines[1:], times, strict=True):
        cells = line.split(delimiter)
        cells[at] = time
        out.append(delimiter.join(cells))
    return "\n".join(out) + "\n"


@pytest.mark.parametrize(
    ("times", "said"),
    [
        (["2026-10-05T06:00:01.008+02:00", "2026-10-05T06:00:01.016+02:00"], {}),
        (["2026-10-05 04:00:01.008Z", '"2026-10-05 04:00:01.016Z"'], {}),
        (["2026-10-05T06:00:01.008", "2026-10-05T06:00:01.016"], {"time_zone": "Europe/Rome"}),
        (["1791172801.008", "1791172801.016"], {}),
        (["1791172801008", "1791172801016"], {}),
        (["1791172801008000", "1791172801016000"], {}),
    ],
)
def test_the_time_of_a_pc_is_read_as_such(tmp_path, ur, times, said):
    path = write(tmp_path / "run.csv", with_times(ur, times))
    assert ADAPTER.recognises(path)
    log = read(path, map=said)
    assert (log.clock, log.warnings, log.set_aside.height) == ("epoch", (), 0)
    assert log.robot["t_s"].to_list() == pytest.approx([1791172801.008, 1791172801.016], abs=1e-6)
    assert log.facts["time"].startswith("the PC's clock")


@pytest.mark.parametrize("form", ["2026-10-05T06:{:02d}:{:02d}Z", "17911728{1:02d}"])
def test_rows_that_share_whole_seconds_of_a_pc_are_spread(tmp_path, ur, form):
    path = write(tmp_path / "run.csv", with_times(ur, [form.format(0, (3 + k) // 25) for k in range(125)]))
    log = read(path)
    assert log.set_aside.is_empty()
    assert log.robot["t_s"].diff().drop_nulls().to_list() == pytest.approx([0.04] * 124, abs=1e-5)
    assert any("spread evenly, at 25 Hz" in said for said in log.warnings)


def test_a_time_of_day_without_a_zone_is_read_and_said_to_lack_it(tmp_path, ur):
    log = read(write(tmp_path / "run.csv", with_times(ur, ["2026-10-05 06:00:01.0", "2026-10-05 06:00:01.5"])))
    assert (log.clock, log.robot["t_s"].diff()[1]) == ("relative", 0.5)
    assert [said for said in log.warnings if 'time_zone, for example "Europe/Rome"' in said]
    with pytest.raises(UnknownName, match="Europe/Rome"):
        read(tmp_path / "run.csv", map={"time_zone": "Europe/Romme"})


def test_a_row_whose_time_is_garbled_costs_only_itself(tmp_path, ur):
    times = [f"2026-10-05T06:00:0{i}+02:00" for i in range(4)]
    times[2] = "2026-10-05T06:0"
    log = read(write(tmp_path / "run.csv", with_times(ur, times)))
    assert log.robot["t_s"].diff().drop_nulls().to_list() == [1.0, 2.0]
    assert log.set_aside.rows() == [(4, "its time in column 'timestamp' is no date and time of day of ISO 8601")]


def test_the_tcp_speed_is_the_norm_of_the_linear_part(tmp_path, ur):
    rows = [ur.row(1.0, actual_TCP_speed_0=0.3, actual_TCP_speed_1=0.4, actual_TCP_speed_5=9.0)]
    robot = read(write(tmp_path / "run.csv", ur.text(rows))).robot
    assert robot["tcp_speed_m_s"][0] == pytest.approx(0.5)


def test_a_sample_that_ur_rtde_writes_twice_counts_once(tmp_path, ur):
    rows = [ur.row(t) for t in (1.0, 1.0, 1.002, 1.002, 1.002, 1.004)]
    log = examined(read(write(tmp_path / "run.csv", ur.text(rows, ",", "\n"))))
    assert log.robot["t_s"].to_list() == [1.0, 1.002, 1.004]
    assert log.set_aside["source_row"].to_list() == [3, 5, 6]
    assert log.rows_read == 6


def test_two_runs_with_a_restarted_controller_keep_their_order(tmp_path, ur):
    rows = [ur.row(t) for t in (5.0, 5.1, 1.0, 1.1)]
    log = read(write(tmp_path / "run.csv", ur.text(rows)))
    assert log.robot["t_s"].to_list() == [5.0, 5.1, 1.0, 1.1]
    assert any("steps back 1 time" in said for said in log.warnings)


def test_a_column_that_stands_at_zero_for_long_and_then_moves_is_read(tmp_path, ur):
    rows = [ur.row(1.0 + i / 500, speed_scaling=0) for i in range(300)]
    rows += [ur.row(2.0, speed_scaling=0.5)]
    assert read(write(tmp_path / "run.csv", ur.text(rows))).robot["scaling"][-1] == 0.5


def test_a_last_line_cut_inside_a_number_is_set_aside(tmp_path, ur):
    text = ur.text([ur.row(1.0), ur.row(1.1), ur.row(1.2, runtime_state=2.375)])
    log = read(write(tmp_path / "run.csv", text.rstrip("\r\n")[:-2]))
    assert log.robot["t_s"].to_list() == [1.0, 1.1]
    assert log.set_aside["source_row"].to_list() == [4]
    assert "cut" in log.set_aside["reason"][0]


def test_blank_lines_between_the_rows_on_windows_are_no_rows(tmp_path, ur):
    text = ur.text([ur.row(1.0), ur.row(1.1)]).replace("\r\n", "\r\n\r\n")
    log = read(write(tmp_path / "run.csv", text))
    assert log.robot["source_row"].to_list() == [3, 5]
    assert log.rows_read == 2
    assert log.set_aside.is_empty()


@pytest.mark.parametrize("harm", [lambda s: s.replace(" ", "  ", 1), lambda s: s.partition(" ")[2], lambda s: s + " 1"])
def test_a_row_of_another_width_is_set_aside_and_never_shifted(tmp_path, ur, harm):
    lines = ur.text([ur.row(t, actual_TCP_pose_1=7.0) for t in (1.0, 1.1, 1.2)]).split("\r\n")
    lines[2] = harm(lines[2])
    log = read(write(tmp_path / "run.csv", "\r\n".join(lines)))
    assert log.robot["t_s"].to_list() == [1.0, 1.2]
    assert log.robot["tcp_y_m"].to_list() == [7.0, 7.0]
    assert log.set_aside["source_row"].to_list() == [3]
    assert "fields where the header has" in log.set_aside["reason"][0]


def test_a_space_at_the_end_of_every_line_changes_nothing(tmp_path, ur):
    rows = [ur.row(1.0, actual_TCP_pose_2=0.7), ur.row(1.1)]
    plain = read(write(tmp_path / "a.csv", ur.text(rows)))
    trailing = read(write(tmp_path / "b.csv", ur.text(rows).replace("\r\n", " \r\n")))
    assert trailing.robot.equals(plain.robot)


def test_a_word_where_a_number_is_due_sets_that_row_aside(tmp_path, ur):
    rows = [ur.row(1.0), ur.row(1.1, actual_q_0="1.0.3"), ur.row(1.2)]
    log = read(write(tmp_path / "run.csv", ur.text(rows)))
    assert log.robot["t_s"].to_list() == [1.0, 1.2]
    assert "'1.0.3' in column 'actual_q_0' is not a number" in log.set_aside["reason"][0]


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16", "utf-16-le"])
def test_a_file_saved_again_by_a_windows_editor_is_read(tmp_path, ur, encoding):
    path = write(tmp_path / "run.csv", ur.text([ur.row(1.0), ur.row(1.1)]), encoding)
    assert ADAPTER.recognises(path)
    assert read(path).robot["t_s"].to_list() == [1.0, 1.1]


def test_a_block_of_nul_bytes_after_a_power_cut_is_set_aside(tmp_path, ur):
    path = tmp_path / "run.csv"
    path.write_bytes(ur.text([ur.row(1.0), ur.row(1.1)]).encode() + b"\0" * 512)
    log = read(path)
    assert log.robot["t_s"].to_list() == [1.0, 1.1]
    assert log.set_aside.height == 1


def test_a_file_name_with_brackets_is_a_name_and_no_pattern(tmp_path, ur):
    write(tmp_path / "runa.csv", ur.text([ur.row(9.0)]))
    path = write(tmp_path / "run[a].csv", ur.text([ur.row(1.0)]))
    assert read(path).robot["t_s"].to_list() == [1.0]


def test_without_a_timestamp_the_cure_is_named(tmp_path):
    path = write(tmp_path / "run.csv", "actual_TCP_force_0,actual_TCP_force_1\n1,2\n")
    assert ADAPTER.recognises(path)
    with pytest.raises(MissingColumns, match="timestamp") as refusal:
        read(path)
    assert "record_configuration.xml" in refusal.value.cure


def test_a_header_without_rows_is_refused_with_that_reason(tmp_path, ur):
    with pytest.raises(DamagedLog, match="a header and no rows"):
        read(write(tmp_path / "run.csv", ur.text([])))


def test_the_register_is_the_one_the_cell_names(tmp_path, ur):
    path = write(tmp_path / "run.csv", ur.text([ur.row(1.0, output_int_register_0=4, output_int_register_3=7)]))
    assert read(path).robot["register"].to_list() == [4]
    assert read(path, map={"register": "output_int_register_3"}).robot["register"].to_list() == [7]
    with pytest.raises(MissingColumns) as refusal:
        read(path, map={"register": "output_int_register_4"})
    assert refusal.value.nearest is not None
    with pytest.raises(UnknownName, match="registr"):
        read(path, map={"registr": "output_int_register_3"})


def test_a_log_in_percent_is_left_unknown_and_said(tmp_path, ur):
    log = read(write(tmp_path / "run.csv", ur.text([ur.row(1.0, target_speed_fraction=80.0)])))
    assert log.robot["scaling"].to_list() == [None]
    assert any("exceeds 1" in said for said in log.warnings)


def test_a_log_without_pose_or_joints_is_refused(tmp_path, ur):
    path = write(tmp_path / "run.csv", "timestamp,speed_scaling,runtime_state\n1,1,2\n")
    with pytest.raises(MissingColumns, match="actual_TCP_pose_0"):
        read(path)


def test_a_folder_and_other_tables_are_not_mine(tmp_path):
    assert not ADAPTER.recognises(tmp_path)
    assert not ADAPTER.recognises(tmp_path / "absent.csv")
    assert not ADAPTER.recognises(write(tmp_path / "a.csv", "timestamp,x,y\n1,2,3\n"))
    with pytest.raises(LogError):
        read(tmp_path / "absent.csv")


def test_values_that_are_nan_or_infinite_are_counted_and_told(tmp_path, ur):
    rows = [ur.row(1.0), ur.row(1.1, actual_TCP_pose_1="nan"), ur.row(1.2, actual_TCP_pose_2="inf")]
    log = read(write(tmp_path / "run.csv", ur.text(rows)))
    assert log.robot["tcp_y_m"].to_list() == [0.0, None, 0.0]
    assert [said for said in log.warnings if "NaN" in said] == [
        "2 values are written as NaN or infinity: unknown there"
    ]
