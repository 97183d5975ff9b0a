from datetime import datetime
from zoneinfo import ZoneInfo

import numpy as np
import polars as pl
import pytest
from damage import read_damaged
from examples import at_most
from hypothesis import given
from hypothesis import strategies as st

from cyclekit.adapter import ReadOptions
from cyclekit.alignment.clocks import lower_envelope
from cyclekit.errors import DamagedLog, LogError, MissingColumns, UnknownName
from cyclekit.ingest.registry import find_adapter
from cyclekit.ingest.validate.validate import examined
from cyclekit.schema import ROBOT
from cyclekit_adapters.formats.kuka_rsi import ADAPTER
from cyclekit_adapters.robots.host_clock import HostClock

COLUMNS = (
    "Timestamp,X_RIst,Y_RIst,Z_RIst,A_RIst,B_RIst,C_RIst,X_RSol,Y_RSol,Z_RSol,A_RSol,B_RSol,C_RSol,Delay,IPOC,ErrorNum"
)


def row(ipoc, x="1279.5", y="192.4", z="977.3", *, delay="0"):
    return f"2024-05-06 14:05:15,{x},{y},{z},80.4,60.3,116.8,9,9,9,80.5,60.3,116.8,{delay},{ipoc},0"


def write(path, *rows, columns=COLUMNS, end="\n"):
    path.write_bytes((end.join([columns, *rows]) + end).encode())
    return path


def read(path, **options):
    return ADAPTER.read(path, ReadOptions(**options))


def test_millimetres_and_the_milliseconds_of_the_controller_become_metres_and_seconds(tmp_path):
    path = write(tmp_path / "robot.csv", row(1210441551), row(1210441563, y="-200.1"))
    assert find_adapter(path).name == "kuka-rsi"
    log = read(path)
    assert log.robot["t_s"].to_list() == pytest.approx([1210441.551, 1210441.563])
    assert log.robot["tcp_x_m"].to_list() == pytest.approx([1.2795, 1.2795])
    assert log.robot["tcp_y_m"].to_list() == pytest.approx([0.1924, -0.2001])
    assert log.robot["tcp_z_m"].to_list() == pytest.approx([0.9773, 0.9773])
    assert log.clock == "uptime"
    assert log.facts["cycle"] == "12 ms"
    assert log.robot.columns == list(ROBOT)


def test_the_set_point_is_not_the_place_and_the_override_is_unknown(tmp_path):
    log = read(write(tmp_path / "robot.csv", row(12), row(24)))
    assert log.robot["tcp_x_m"].to_list() == pytest.approx([1.2795] * 2)
    assert log.robot["scaling"].null_count() == 2
    assert any("speed scaling" in said for said in log.warnings)


def test_an_override_column_of_the_client_is_pointed_at_and_not_guessed(tmp_path):
    path = write(tmp_path / "robot.csv", row(12) + ",50", columns=COLUMNS + ",OV_PRO")
    log = read(path)
    assert log.robot["scaling"].to_list() == [None]
    assert any("'OV_PRO'" in said and "scaling_max = 100" in said for said in log.warnings)


@pytest.mark.parametrize("end", ["\n", "\r\n", "\r\n\r\n"])
def test_a_client_on_windows_writes_the_same_log(tmp_path, end):
    log = read(write(tmp_path / "robot.csv", row(12), row(24), end=end))
    assert log.robot["t_s"].to_list() == pytest.approx([0.012, 0.024])
    assert log.set_aside.is_empty()


def test_a_cycle_that_is_written_twice_counts_once(tmp_path):
    log = examined(read(write(tmp_path / "robot.csv", row(12), row(12), row(24))))
    assert log.robot["source_row"].to_list() == [2, 4]
    assert log.set_aside.rows() == [(3, "repeats a row before it, with all its values")]
    assert log.rows_read == 3


def test_late_packets_and_a_restarted_controller_are_said(tmp_path):
    log = read(write(tmp_path / "robot.csv", row(120), row(132, delay="3"), row(12)))
    assert any("3 late packets" in said for said in log.warnings)
    assert any("steps back 1 time" in said for said in log.warnings)
    assert log.robot.height == 3


def test_a_row_cut_while_being_written_is_set_aside(tmp_path):
    path = write(tmp_path / "robot.csv", row(12), row(24))
    path.write_bytes(path.read_bytes()[:-8])
    log = read(path)
    assert log.robot["source_row"].to_list() == [2]
    assert "cut" in log.set_aside["reason"][0]


def test_between_semicolons_a_comma_in_a_number_is_decimal(tmp_path):
    path = tmp_path / "robot.csv"
    path.write_text("IPOC;X_RIst;Y_RIst;Z_RIst\n12;1279,5;0,1;-0,2\n24;1280;0;80\n", encoding="utf-8")
    log = read(path)
    assert log.robot["tcp_x_m"].to_list() == pytest.approx([1.2795, 1.28])
    assert log.robot["tcp_z_m"].to_list() == pytest.approx([-0.0002, 0.08])
    path.write_text("IPOC;X_RIst;Y_RIst;Z_RIst\n12;1279.5;0.1;0.2\n", encoding="utf-8")
    assert read(path).robot["tcp_x_m"].to_list() == pytest.approx([1.2795])


def test_a_log_without_one_axis_names_it(tmp_path):
    path = write(tmp_path / "robot.csv", "12,1,2", columns="IPOC,X_RIst,Z_RIst")
    assert ADAPTER.recognises(path)
    with pytest.raises(MissingColumns, match="Y_RIst"):
        read(path)


def test_a_header_without_rows_and_an_unknown_key_are_refused(tmp_path):
    path = write(tmp_path / "robot.csv")
    with pytest.raises(DamagedLog, match="a header and no rows"):
        read(path)
    with pytest.raises(UnknownName, match="scaling"):
        read(path, map={"scaling": "OV_PRO"})


def stamped(seconds, *, late_s=0.0, begin=1_715_000_000.3, decimals=0, gap=None, seed=1):
    """Rows of a 12 ms cycle with the PC's time, cut to whole seconds, in Rome; and what it was when IPOC was zero."""
    rng = np.random.default_rng(seed)
    device_ms = np.arange(0, seconds * 1000, 12) + 5_000
    true_s = begin + device_ms / 1000 + late_s + rng.exponential(0.002, device_ms.size)
    rows = []
    for ipoc, host_s in zip(device_ms.tolist(), true_s.tolist(), strict=True):
        if gap and gap[0] <= ipoc <= gap[1]:
            continue
        shown = datetime.fromtimestamp(int(host_s * 10**decimals) / 10**decimals, ZoneInfo("Europe/Rome"))
        text = shown.strftime("%Y-%m-%d %H:%M:%S") + (f".{shown.microsecond // 1000:03d}" if decimals else "")
        rows.append(row(ipoc).replace("2024-05-06 14:05:15", text))
    return rows, begin + late_s


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize(("decimals", "worst_s"), [(0, 0.012), (3, 0.001)])
def test_the_second_in_which_the_pc_wrote_places_the_log_to_a_cycle(tmp_path, seed, decimals, worst_s):
    rows, offset_s = stamped(60, decimals=decimals, seed=seed)
    log = read(write(tmp_path / "robot.csv", *rows), map={"time_zone": "Europe/Rome"})
    assert log.stamps.height == pytest.approx(len(rows) if decimals else 60, abs=20 if decimals else 1)
    fit = lower_envelope(log.stamps["t_s"].to_numpy(), log.stamps["host_s"].to_numpy())
    at = np.array([5.0, 65.0])
    error = fit.rate * at + fit.offset_s - (at + offset_s)
    assert (error > -worst_s - 1e-4).all()  # never earlier than by a cycle
    assert (error < 0.003).all()
    assert log.clock == "uptime"
    assert "Europe/Rome" in log.facts["host_clock"]


def test_a_second_that_changed_while_rows_were_missing_tells_nothing(tmp_path):
    rows, offset_s = stamped(60, gap=(20_000, 23_800))
    log = read(write(tmp_path / "robot.csv", *rows), map={"time_zone": "Europe/Rome"})
    apart = (log.stamps["host_s"] - log.stamps["t_s"]).to_numpy() - offset_s
    assert apart.min() > -0.0121
    assert 54 <= log.stamps.height <= 57


def test_a_time_of_day_without_a_zone_is_not_guessed_at(tmp_path):
    rows, _ = stamped(3)
    log = read(write(tmp_path / "robot.csv", *rows))
    assert log.stamps is None
    assert [said for said in log.warnings if "'Timestamp'" in said and "time_zone" in said]
    with pytest.raises(UnknownName, match="Rom"):
        read(tmp_path / "robot.csv", map={"time_zone": "Rome"})


@pytest.mark.parametrize(
    ("before", "after"),
    [
        ("2024-05-06T12:53:20Z", "2024-05-06T12:53:21Z"),
        ("2024-05-06 14:53:20+02:00", "2024-05-06 14:53:21+02:00"),
        ("1715000000", "1715000001.0"),
    ],
)
def test_a_time_that_names_its_zone_needs_none(tmp_path, before, after):
    rows = [row(12 * n).replace("2024-05-06 14:05:15", before if n < 5 else after) for n in range(9)]
    log = read(write(tmp_path / "robot.csv", *rows))
    assert log.stamps["t_s"].to_list() == pytest.approx([0.06])
    assert log.stamps["host_s"].to_list() == pytest.approx([1_715_000_001.0])


def test_the_stamps_of_a_log_in_parts_are_those_of_the_whole(tmp_path):
    rows, _ = stamped(30)
    path = write(tmp_path / "robot.csv", *rows)
    whole = read(path, map={"time_zone": "Europe/Rome"}).stamps
    host = HostClock("Timestamp", "Europe/Rome")
    t_s = pl.Series([float(one.split(",")[14]) for one in rows]) * 1e-3
    text = pl.Series([one.split(",")[0] for one in rows])
    parts = [host.stamps(t_s[n : n + 100], text[n : n + 100]) for n in range(0, len(rows), 100)]
    assert pl.concat(parts).equals(whole)


def test_other_tables_and_folders_are_not_mine(tmp_path):
    assert not ADAPTER.recognises(tmp_path)
    assert not ADAPTER.recognises(write(tmp_path / "a.csv", "1,2", columns="IPOC,speed"))
    with pytest.raises(LogError):
        read(tmp_path / "absent.csv")


def test_a_damaged_log_is_read_in_part_or_refused(tmp_path):
    path = write(tmp_path / "robot.csv", *(row(12 * i, x=str(i)) for i in range(6)))
    read_damaged(ADAPTER, path, path.read_bytes(), seed=21)


@at_most(40)
@given(st.lists(st.tuples(st.integers(-(10**6), 10**6), st.integers(1, 500)), min_size=1, max_size=20))
def test_any_log_of_whole_rows_comes_back_as_it_was_written(tmp_path_factory, cycles):
    ipoc, rows = 0, []
    for tenths, step in cycles:
        ipoc += step
        rows.append((ipoc, tenths / 10))
    path = write(tmp_path_factory.mktemp("rsi") / "robot.csv", *(row(t, x=f"{x:.1f}") for t, x in rows))
    robot = read(path).robot
    assert robot["t_s"].to_list() == pytest.approx([t / 1000 for t, _ in rows])
    assert robot["tcp_x_m"].to_list() == pytest.approx([x / 1000 for _, x in rows])


@pytest.mark.parametrize("name", ["RIst_X", "RIst.X", "RIstX", "RIst X", "X_RIst", "XRIst", "rist_x", "X_rist"])
def test_every_client_puts_the_names_together_in_its_own_way(tmp_path, name):
    columns = [name.replace("X", axis) if "X" in name else name.replace("_x", f"_{axis.lower()}") for axis in "XYZABC"]
    path = write(
        tmp_path / "robot.csv", "100,200,300,1,2,3,12", "100,200,300,1,2,3,24", columns=",".join([*columns, "Ipoc"])
    )
    assert find_adapter(path).name == "kuka-rsi"
    assert read(path).robot.select("t_s", "tcp_x_m", "tcp_y_m", "tcp_z_m").row(1) == pytest.approx(
        (0.024, 0.1, 0.2, 0.3)
    )


def test_axes_are_degrees(tmp_path):
    axes = ",".join(f"A{axis}_AIPos" for axis in range(1, 7))
    turned = "0,-90,90,180,45,-360"
    path = write(tmp_path / "robot.csv", f"{turned},1,2,3,12", columns=f"{axes},X_RIst,Y_RIst,Z_RIst,IPOC")
    log = read(path)
    expected = np.pi * np.array([0, -0.5, 0.5, 1, 0.25, -2])
    assert log.robot.select(f"q{axis}_rad" for axis in range(6)).row(0) == pytest.approx(tuple(expected))
    assert log.joint_names == tuple(axes.split(","))
    assert log.robot["tcp_x_m"].to_list() == pytest.approx([0.001])
    alone = read(write(tmp_path / "axes.csv", f"{turned},12", columns=f"{axes},IPOC"))
    assert alone.robot["q3_rad"].to_list() == pytest.approx([np.pi])
    assert any("RIst not recorded" in said for said in alone.warnings)
    assert find_adapter(tmp_path / "axes.csv").name == "kuka-rsi"


def test_a_log_without_ipoc_says_how_it_can_be_read(tmp_path):
    path = write(tmp_path / "robot.csv", "2024-05-06 14:05:15,1,2,3", columns="Timestamp,X_RIst,Y_RIst,Z_RIst")
    assert find_adapter(path).name == "kuka-rsi"
    with pytest.raises(MissingColumns, match="'IPOC'") as refusal:
        read(path)
    assert 'adapter = "csv"' in str(refusal.value)


@pytest.mark.parametrize("written", ["%d.%m.%Y %H:%M:%S", "%Y/%m/%d %H:%M:%S", "%Y-%m-%dT%H:%M:%S"])
def test_the_pcs_time_may_be_written_as_in_other_logs(tmp_path, written):
    rows, offset_s = stamped(10)
    dates = [datetime.fromisoformat(one[:19]).strftime(written) + one[19:] for one in rows]
    log = read(write(tmp_path / "robot.csv", *dates), map={"time_zone": "Europe/Rome"})
    assert (log.stamps["host_s"] - log.stamps["t_s"] - offset_s).abs().max() < 0.02


def test_a_pcs_time_that_cannot_be_read_is_said(tmp_path):
    rows = [one.replace("2024-05-06 14:05:15", "6 May 14:05:15") for one in (row(12), row(24))]
    log = read(write(tmp_path / "robot.csv", *rows), map={"time_zone": "Europe/Rome"})
    assert [said for said in log.warnings if "'Timestamp' holds no date and time that can be read" in said]


def test_the_pcs_time_goes_on_through_the_hour_that_is_repeated(tmp_path):
    ends = datetime(2026, 10, 25, 1, 0, tzinfo=ZoneInfo("UTC")).timestamp()
    rows, offset_s = stamped(60, begin=ends - 40.0)
    log = read(write(tmp_path / "robot.csv", *rows), map={"time_zone": "Europe/Rome"})
    assert (log.stamps["host_s"] - log.stamps["t_s"] - offset_s).abs().max() < 0.02
