import pytest

from cyclekit.adapter import ReadOptions
from cyclekit.errors import DamagedLog
from cyclekit_adapters.formats.ur_split import ADAPTER


def write(folder, name, rows, end="\n"):
    text = end.join(", ".join(f"{value:.6f}" for value in row) for row in rows) + end
    (folder / name).write_text(text, newline="")


def folder_of(tmp_path, pose=10, joints=10):
    write(tmp_path, "log_tool_vector.csv", [(i * 0.008, i * 0.01, 0.5, 0.2, 0, 3.14, 0) for i in range(pose)])
    write(tmp_path, "log_tcp_speed.csv", [(i * 0.008, 0.3, 0.4, 0, 9, 9, 9) for i in range(pose)])
    write(tmp_path, "log_q_actual.csv", [(i * 0.008, i, 0, 0, 0, 0, -1) for i in range(joints)])
    return tmp_path


def test_a_folder_of_one_file_per_signal_becomes_one_robot_table(tmp_path):
    folder = folder_of(tmp_path)
    assert ADAPTER.recognises(folder)
    log = ADAPTER.read(folder, ReadOptions())
    assert log.robot["tcp_x_m"].to_list() == pytest.approx([i * 0.01 for i in range(10)])
    assert log.robot["q0_rad"].to_list() == [float(i) for i in range(10)]
    assert log.robot["tcp_speed_m_s"].to_list() == pytest.approx([0.5] * 10)
    assert log.robot["scaling"].null_count() == 10


def test_a_signal_that_ended_earlier_is_unknown_from_there_on(tmp_path):
    log = ADAPTER.read(folder_of(tmp_path, pose=60, joints=4), ReadOptions())
    assert log.robot["q0_rad"].to_list()[:5] == [0.0, 1.0, 2.0, 3.0, None]
    assert log.robot.height == 60
    assert any("log_q_actual.csv ends" in said for said in log.warnings)


def test_a_line_cut_while_the_logger_was_killed_is_set_aside(tmp_path):
    folder = folder_of(tmp_path)
    path = folder / "log_tool_vector.csv"
    path.write_bytes(path.read_bytes()[:-5])
    log = ADAPTER.read(folder, ReadOptions())
    assert log.robot.height == 9
    assert "log_tool_vector.csv" in log.set_aside["reason"][0]


def test_other_folders_are_not_mine_and_an_empty_log_is_refused(tmp_path):
    assert not ADAPTER.recognises(tmp_path)
    (tmp_path / "log_tool_vector.csv").write_text("0.0, 1, 2")
    assert not ADAPTER.recognises(tmp_path)
    with pytest.raises(DamagedLog, match="usable row"):
        ADAPTER.read(tmp_path, ReadOptions())
