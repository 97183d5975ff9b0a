import math

import pytest

from cyclekit.adapter import ReadOptions, concat_parts
from cyclekit.errors import ConfigError, DamagedLog, LogError, MissingColumns, UnknownName
from cyclekit.ingest.validate.validate import examined
from cyclekit_adapters.formats.mapped_csv import ADAPTER


def read(path, text, role=None, rate_hz=None, saved_as="utf-8", **mapping):
    path.write_bytes(text.encode(saved_as))
    assert not ADAPTER.recognises(path)
    return ADAPTER.read(path, ReadOptions(role=role, map=mapping, rate_hz=rate_hz))


def test_a_robot_table_in_millimetres_degrees_and_percent_comes_out_in_si(tmp_path):
    text = "ms;X;Y;Z;J1;OVR;V\n1500;1000;-250;50;180;50;200\n"
    log = read(
        tmp_path / "kuka.csv",
        text,
        time="ms",
        time_unit="ms",
        clock="uptime",
        x="X",
        y="Y",
        z="Z",
        length_unit="mm",
        joints=["J1"],
        joint_unit="deg",
        scaling="OVR",
        scaling_max=100,
        speed="V",
    )
    row = log.robot.row(0, named=True)
    assert (row["t_s"], row["tcp_x_m"], row["tcp_y_m"], row["tcp_z_m"]) == (1.5, 1.0, -0.25, 0.05)
    assert row["q0_rad"] == pytest.approx(math.pi)
    assert (row["scaling"], row["tcp_speed_m_s"]) == (0.5, 0.2)
    assert (log.clock, log.joint_names) == ("uptime", ("J1",))


def test_decimal_comma_latin_1_and_lines_above_the_header(tmp_path):
    text = "Anlage: Süd\nStand: heute\nZeit;Pos_x;Pos_y\n0,5;1,25;2\n1,0;1,5;2\n"
    log = read(
        tmp_path / "log.csv",
        text,
        saved_as="latin-1",
        encoding="latin-1",
        role="people",
        decimal=",",
        skip_rows=2,
        time="Zeit",
        x="Pos_x",
        y="Pos_y",
    )
    assert log.people.select("t_s", "x_m", "y_m", "z_m").rows() == [(0.5, 1.25, 2.0, None), (1.0, 1.5, 2.0, None)]


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16"])
def test_a_table_saved_by_a_windows_editor(tmp_path, encoding):
    log = read(tmp_path / "log.csv", "t,x,y\n1,2,3\n", role="people", saved_as=encoding, time="t", x="x", y="y")
    assert log.people["x_m"].to_list() == [2.0]


def test_people_by_id_and_those_not_seen(tmp_path):
    text = "t,id,x,y,z\n0,ann,1,2,0\n0,bo,,,\n1,,3,4,5\n"
    log = read(tmp_path / "log.csv", text, time="t", person="id", x="x", y="y", z="z")
    assert log.people["person"].to_list() == ["ann", "bo"]
    assert log.people["x_m"].to_list() == [1.0, None]
    assert log.set_aside["source_row"].to_list() == [4]


def test_a_signal_may_be_named_by_device_and_event(tmp_path):
    text = "t;device;event;state\n0;S1;field;free\n1;S2 ;field;occupied\n2;;reset;1\n"
    log = read(
        tmp_path / "plc.csv", text, time="t", signal=["device", "event"], value="state", names={"S1 / field": "a"}
    )
    assert log.events.select("signal", "value").rows() == [("a", "free"), ("S2 / field", "occupied")]
    assert log.set_aside["source_row"].to_list() == [4]


def test_the_inputs_of_another_robot_in_one_number_are_events_bit_by_bit(tmp_path):
    log = read(tmp_path / "other.csv", "t;DI\n0;2\n1;3\n2;3\n3;1\n", time="t", digital_in="DI", role="events")
    assert log.events.select("t_s", "signal", "value").rows() == [
        *((0.0, "DI 0", "0"), (0.0, "DI 1", "1")),
        (1.0, "DI 0", "1"),
        (3.0, "DI 1", "0"),
    ]


def test_events_keep_signal_and_value_as_text(tmp_path):
    text = 't,tag,val\n1,button,1\n2,"door, left",open\n'
    log = read(tmp_path / "plc.csv", text, time="t", signal="tag", value="val")
    assert log.events.select("signal", "value").rows() == [("button", "1"), ("door, left", "open")]


def test_without_a_clock_the_cure_names_the_rate_and_the_rate_makes_one(tmp_path):
    text = "x,y\n1,2\n3,4\n"
    with pytest.raises(MissingColumns) as refusal:
        read(tmp_path / "log.csv", text, role="people", x="x", y="y")
    assert "rate_hz" in refusal.value.cure
    log = read(tmp_path / "log.csv", text, role="people", rate_hz=50.0, x="x", y="y")
    assert log.people["t_s"].to_list() == [0.0, 0.02]


def test_a_row_set_aside_does_not_move_the_clock_of_a_rate(tmp_path):
    log = read(tmp_path / "log.csv", "x,y\n1,2\n3,4,5\n5,6\n", role="people", rate_hz=10.0, x="x", y="y")
    assert log.people["t_s"].to_list() == [0.0, 0.2]


def test_a_column_that_is_not_there_is_named_with_the_nearest(tmp_path):
    with pytest.raises(MissingColumns, match="pos_y") as refusal:
        read(tmp_path / "log.csv", "t,pos_x,pos_Y\n1,2,3\n", role="people", time="t", x="pos_x", y="pos_y")
    assert refusal.value.nearest in ("pos_Y", "pos_x")


@pytest.mark.parametrize(
    "mapping",
    [
        {"tiem": "t"},
        {"time_unit": "weeks"},
        {"time_unit": "0 ms"},
        {"length_unit": "feet"},
        {"joint_unit": "grad"},
        {"clock": "utc"},
        {"scaling_max": 255},
        {"skip_rows": -1},
        {"joints": 1},
        {"delimiter": ""},
        {"delimiter": "\n"},
        {"time_zone": "Europe/Rome"},
        {"time_format": "iso", "time_zone": "Europe/Roma"},
        {"time_unit": "frame"},
        {"time": ["t", "u"]},
        {"encoding": "utf-99"},
        {"encoding": "hex"},
        {"states": {"3": "working"}},
        {"decimal": ".", "delimiter": "."},
        {"time": ["t", "x"], "time_unit": ["ns", "s"]},
        {"time": ["t"], "time_unit": ["s", "ns"]},
        {"person": "*"},
    ],
)
def test_a_cell_file_that_says_something_impossible_is_refused(tmp_path, mapping):
    with pytest.raises(ConfigError):
        read(tmp_path / "log.csv", "t,x,y\n1,2,3\n", **({"role": "people", "time": "t", "x": "x", "y": "y"} | mapping))


def test_an_unknown_key_shows_the_nearest(tmp_path):
    with pytest.raises(UnknownName) as refusal:
        read(tmp_path / "log.csv", "t,x,y\n1,2,3\n", role="people", tiem="t", x="x", y="y")
    assert refusal.value.nearest == "time"


def test_a_map_that_could_be_robot_or_person_must_say_which(tmp_path):
    with pytest.raises(ConfigError, match="no role is given"):
        read(tmp_path / "log.csv", "t,x,y\n1,2,3\n", time="t", x="x", y="y")


def test_a_percentage_taken_for_a_fraction_is_unknown_and_said(tmp_path):
    log = read(tmp_path / "log.csv", "t,o\n1,0.5\n2,80\n", time="t", scaling="o")
    assert log.robot["scaling"].to_list() == [0.5, None]
    assert any("scaling_max" in said for said in log.warnings)


def test_program_states_by_the_words_of_the_cell_file(tmp_path):
    text = "t,x,y,s\n1,0,0,AUTO\n2,0,0,playing\n3,0,0,JOG\n"
    log = read(tmp_path / "log.csv", text, time="t", x="x", y="y", state="s", states={"AUTO": "playing"})
    assert log.robot["state"].to_list() == ["playing", "playing", None]
    assert any("'JOG'" in said for said in log.warnings)


def test_a_header_and_no_rows_is_refused(tmp_path):
    with pytest.raises(DamagedLog, match="a header and no rows"):
        read(tmp_path / "log.csv", "\ufefft,x,y\n", role="people", time="t", x="x", y="y")


def test_a_repeated_instant_of_the_robot_counts_once(tmp_path):
    log = examined(read(tmp_path / "log.csv", "t,x,y\n1,0,0\n1,0,0\n2,1,0\n", role="robot", time="t", x="x", y="y"))
    assert log.robot["t_s"].to_list() == [1.0, 2.0]
    assert log.set_aside["source_row"].to_list() == [3]


def test_a_file_name_with_brackets_is_a_name_and_no_pattern(tmp_path):
    (tmp_path / "runa.csv").write_text("t,x,y\n9,9,9\n")
    log = read(tmp_path / "run[a].csv", "t,x,y\n1,2,3\n", role="people", time="t", x="x", y="y")
    assert log.people["x_m"].to_list() == [2.0]


@pytest.mark.parametrize(
    ("text", "pattern", "zone", "seconds"),
    [
        ("01.05.2024 12:00:00,250", "%d.%m.%Y %H:%M:%S%.f", "Europe/Rome", 1714557600.25),
        ("2024-05-01 10:00:00.250 +0200", "%Y-%m-%d %H:%M:%S%.f %z", None, 1714550400.25),
        ("2024-05-01 10:00:00.250", "iso", None, 1714557600.25),
        ("2024-05-01T10:00:00.250Z", "iso", None, 1714557600.25),
        ("2024-05-01 10:00:00,250+02:00", "iso", None, 1714550400.25),
        ("2024-05-01 12:00:00.25", "iso", "Europe/Rome", 1714557600.25),
        ("01.05.2024 12:00:00.250", "%d.%m.%Y %H:%M:%S%.f", "Europe/Rome", 1714557600.25),
        ("05/01/24 10:00", "%m/%d/%y %H:%M", "UTC", 1714557600.0),
        ("10:00:00.5", "%H:%M:%S%.f", None, 36000.5),
    ],
)
def test_times_written_as_text(tmp_path, text, pattern, zone, seconds):
    mapping = {"time_format": pattern} | ({"time_zone": zone} if zone else {})
    log = read(tmp_path / "log.csv", f't;x;y\n"{text}";2;3\n', role="people", time="t", x="x", y="y", **mapping)
    assert log.people["t_s"].to_list() == [pytest.approx(seconds, abs=1e-6)]
    placed = bool(zone) or text.endswith(("Z", "00"))  # the text names its zone
    assert log.clock == ("epoch" if placed else "relative")
    assert any("cannot be aligned" in said for said in log.warnings) != placed


def test_where_times_name_their_zone_one_that_does_not_is_set_aside(tmp_path):
    text = "t;x;y\n2024-05-01T10:00:00+02:00;1;2\n2024-05-01T10:00:01;1;2\n2024-05-01T10:00:02+02:00;1;2\n"
    log = read(tmp_path / "log.csv", text, role="people", time="t", x="x", y="y", time_format="iso")
    assert log.people["t_s"].to_list() == [1714550400.0, 1714550402.0]
    assert log.set_aside["source_row"].to_list() == [3]


def test_a_log_of_which_no_time_can_be_read_is_refused(tmp_path):
    how = {"time": "t", "x": "x", "y": "y", "time_format": "%d/%m/%Y %H:%M"}
    with pytest.raises(DamagedLog, match=r"none of its 2 rows can be used; the first \(line 2\): its time does not"):
        read(tmp_path / "log.csv", "t;x;y\n2024-05-01;1;2\n2024-05-02;1;2\n", role="people", **how)


def test_a_clock_said_to_be_epoch_must_be_one(tmp_path):
    how = {"role": "robot", "time": "t", "x": "x", "y": "y", "clock": "epoch"}
    with pytest.raises(LogError, match="not in the years 2000 to 2099") as refusal:
        read(tmp_path / "log.csv", "t,x,y\n1714557600000,0,0\n1714557600010,0,0\n", time_unit="s", **how)
    assert "time_unit" in str(refusal.value)
    log = read(tmp_path / "log.csv", "t,x,y\n1714557600000,0,0\n1714557600010,0,0\n", time_unit="ms", **how)
    assert log.robot["t_s"].to_list() == pytest.approx([1714557600.0, 1714557600.01])


def test_a_decimal_comma_that_was_not_mapped_is_named_in_the_cure(tmp_path):
    with pytest.raises(DamagedLog, match="'0,5' in column 't'") as refusal:
        read(tmp_path / "log.csv", "t;x;y\n0,5;1;2\n", role="robot", time="t", x="x", y="y")
    assert 'decimal = ","' in str(refusal.value)


def test_a_date_and_a_time_of_day_in_two_columns(tmp_path):
    text = "Datum;Zeit;x;y\n31.12.2023;23:59:59.9;1;2\n01.01.2024;00:00:00.1;1;2\nheute;00:00:01;1;2\n"
    how = {"time": ["Datum", "Zeit"], "time_format": "%d.%m.%Y %H:%M:%S%.f", "time_zone": "UTC"}
    log = read(tmp_path / "log.csv", text, role="people", x="x", y="y", **how)
    assert log.people["t_s"].diff().to_list()[1] == pytest.approx(0.2, abs=1e-6)
    assert log.set_aside["source_row"].to_list() == [4]
    assert "'heute 00:00:01'" in log.set_aside["reason"][0]


def test_a_count_of_frames_is_a_clock_with_a_rate(tmp_path):
    text = "frame,x,y\n10,1,2\n13,1,2\n"
    log = read(tmp_path / "log.csv", text, role="people", rate_hz=30.0, time="frame", time_unit="frame", x="x", y="y")
    assert log.people["t_s"].to_list() == pytest.approx([10 / 30, 13 / 30])


def test_a_table_without_a_header_line(tmp_path):
    log = read(
        tmp_path / "log.csv", "0.5 1 2\n0.6 3 4\n", role="people", columns=["t", "x", "y"], time="t", x="x", y="y"
    )
    assert log.people.select("t_s", "x_m", "y_m", "source_row").rows() == [(0.5, 1, 2, 1), (0.6, 3, 4, 2)]


def test_overrides_that_multiply_and_the_slider_alone(tmp_path):
    how = {"time": "t", "scaling": ["GENOVERRIDE", "clamp"], "scaling_max": 100, "slider": "GENOVERRIDE"}
    log = read(tmp_path / "log.csv", "t,GENOVERRIDE,clamp\n1,80,50\n2,80,100\n", **how)
    assert log.robot["scaling"].to_list() == [0.4, 0.8]
    assert log.robot["slider"].to_list() == [0.8, 0.8]


def test_outputs_and_a_register_that_marks_executions(tmp_path):
    log = read(
        tmp_path / "log.csv", "t,x,y,do,n\n1,0,0,5,7\n", "robot", time="t", x="x", y="y", digital_out="do", register="n"
    )
    assert log.robot.select("digital_out_bits", "register").rows() == [(5, 7)]


def test_a_log_that_is_read_in_parts_is_the_log_read_at_once(tmp_path, monkeypatch):
    text = "t,x,y,o\n" + "".join(f"{i // 2},{i},0,{i % 120}\n" for i in range(200))
    options = ReadOptions(role="robot", map={"time": "t", "x": "x", "y": "y", "scaling": "o", "scaling_max": 100})
    (tmp_path / "log.csv").write_text(text)
    at_once = ADAPTER.read(tmp_path / "log.csv", options)
    monkeypatch.setattr("cyclekit_adapters.text.text_blocks.BLOCK_BYTES", 100)
    parts = list(ADAPTER.stream(tmp_path / "log.csv", options))
    assert len(parts) > 10
    assert concat_parts(parts).robot.equals(at_once.robot)
    assert concat_parts(parts).set_aside.equals(at_once.set_aside)
    assert concat_parts(parts).warnings == at_once.warnings != ()
