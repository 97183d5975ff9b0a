"""Logs in a zip, a tar or Parquet are read like the text in them; what is no single log says what it is."""

import io
import tarfile
import zipfile

import polars as pl
import pytest

from cyclekit.adapter import ReadOptions
from cyclekit.errors import DamagedLog, LogError
from cyclekit_adapters.formats import mapped_csv, task_list, ur_rtde

ROWS = 600
PLACES = [0.5 + 0.001 * i for i in range(ROWS)]
POSES = [f"actual_TCP_pose_{axis}" for axis in range(6)]
TABLE = pl.DataFrame({"timestamp": [0.01 * i for i in range(ROWS)], **dict.fromkeys(POSES, PLACES)})


def zipped(path, names):
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name in names:
            archive.writestr(name, TABLE.write_csv())
        archive.writestr("__MACOSX/._log.csv", b"\0")
    return path


def in_tar(path, names, how="w:gz"):
    with tarfile.open(path, how) as archive:
        folder = tarfile.TarInfo("logs")
        folder.type = tarfile.DIRTYPE
        archive.addfile(folder)
        archive.addfile(tarfile.TarInfo("logs/._log.csv"))
        for name in names:
            raw = TABLE.write_csv().encode()
            about = tarfile.TarInfo(name)
            about.size = len(raw)
            archive.addfile(about, io.BytesIO(raw))
    return path


def in_parquet(path, _names):
    TABLE.write_parquet(path)
    return path


@pytest.mark.parametrize("pack", [zipped, in_tar, lambda path, names: in_tar(path, names, "w"), in_parquet])
def test_a_packed_log_is_recognised_and_read_as_it_was_written(tmp_path, pack):
    path = pack(tmp_path / "log", ["logs/log.csv"])
    assert ur_rtde.ADAPTER.recognises(path)
    robot = ur_rtde.ADAPTER.read(path, ReadOptions()).robot
    assert robot["tcp_x_m"].to_list() == PLACES
    assert robot["source_row"][0] == 2


def test_the_second_file_of_an_archive_is_not_left_out_in_silence(tmp_path):
    path = in_tar(tmp_path / "log.tar.gz", ["a.csv", "b.csv"])
    with pytest.raises(DamagedLog, match="an archive of several files") as refusal:
        ur_rtde.ADAPTER.read(path, ReadOptions())
    assert "python -m tarfile -e" in refusal.value.cure
    assert not ur_rtde.ADAPTER.recognises(zipped(tmp_path / "log.zip", ["a.csv", "b.csv"]))


def test_lists_structs_and_dates_of_a_parquet_table_are_columns(tmp_path):
    begin = pl.datetime(2024, 5, 14, 6, 30, time_unit="ms", time_zone="UTC")
    table = pl.select(time=begin + pl.duration(milliseconds=10) * pl.int_range(ROWS)).with_columns(
        pl.Series("q", [[0.3 * axis + 0.001 * i for axis in range(6)] for i in range(ROWS)]),
        pl.Series("tcp", [{"x": place, "y": 0.25, "z": 0.5} for place in PLACES]),
        pl.lit(b"picture").alias("image"),
    )
    table.write_parquet(path := tmp_path / "robot.parquet")
    draft = {line.key: line.value for line in mapped_csv.ADAPTER.draft(path).map}
    assert (draft["time"], draft["x"], len(draft["joints"])) == ("time", "tcp.x", 6)
    options = ReadOptions(role="robot", map={"time": "time", "joints": ["q"], "x": "tcp.x", "y": "tcp.y", "z": "tcp.z"})
    robot = mapped_csv.ADAPTER.read(path, options).robot
    assert robot.select("t_s", "tcp_x_m", "q5_rad").row(-1) == pytest.approx((1715668205.99, PLACES[-1], 2.099))


def test_a_parquet_table_of_tasks_is_a_task_list_and_a_damaged_one_is_refused(tmp_path):
    table = pl.DataFrame({"agent": ["robot"], "task": ["pick"], "start_s": [1.0], "end_s": [3.5], "execution": ["1"]})
    table.write_parquet(path := tmp_path / "tasks.parquet")
    assert task_list.ADAPTER.recognises(path)
    assert task_list.ADAPTER.read(path, ReadOptions()).task_list["end_s"].to_list() == [3.5]
    path.write_bytes(path.read_bytes()[:-40])
    assert not task_list.ADAPTER.recognises(path)
    with pytest.raises(LogError, match="not a Parquet table that can be read"):
        mapped_csv.ADAPTER.draft(path)
