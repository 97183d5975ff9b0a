"""The map that is proposed for a table that nobody knows: what it says reads the table; what it cannot know it asks."""

import math
import tomllib
from datetime import UTC, datetime, timedelta

import pytest
from examples import at_most
from hypothesis import HealthCheck, given
from hypothesis import strategies as st

from cyclekit.adapter import ReadOptions
from cyclekit.config import Cell, Source, cell_to_toml, load_cell
from cyclekit.errors import ConfigError, MissingColumns
from cyclekit_adapters.formats.mapped_csv import ADAPTER

ROWS = 60


def draft(path, text, encoding="utf-8"):
    path.write_bytes(text.encode(encoding))
    return ADAPTER.draft(path)


def written(folder, proposed, log):
    """The cell file of a draft, read back."""
    cell = Cell(sources=(Source(log.name, "csv"),))
    file = folder / "cell.toml"
    file.write_text(cell_to_toml(cell, {log.name: proposed}), encoding="utf-8")
    return load_cell(file).sources[0]


def ingested(folder, proposed, log):
    source = written(folder, proposed, log)
    return ADAPTER.read(log, ReadOptions(role=source.role, map=source.map, rate_hz=source.rate_hz))


def asked(proposed):
    return {p.key for p in (*proposed.source, *proposed.map) if not p.sure}


def values(proposed):
    return {p.key: p.value for p in (*proposed.source, *proposed.map)}


TIMES = {
    "plain": (["time"], lambda t: [f"{t:.4f}"], 0),
    "unit": (["Time [ms]"], lambda t: [f"{1000 * t:.1f}"], 0),
    "ticks": (["timestamp_us"], lambda t: [f"{1e6 * t:.0f}"], 0),
    "epoch": (["stamp"], lambda t: [f"{1e3 * (1714557600 + t):.0f}"], 1714557600),
    "split": (
        ["header.stamp.sec", "header.stamp.nanosec"],
        lambda t: [f"{1714557600 + int(t)}", f"{round(t % 1 * 1e9)}"],
        1714557600,
    ),
    "iso": (
        ["timestamp"],
        lambda t: [f"{datetime(2024, 5, 1, 10, tzinfo=UTC) + timedelta(seconds=t):%FT%T.%fZ}"],
        1714557600,
    ),
}
PLACES = [
    "tcp_{}",
    "Actual_TCP_{}",
    "robot.pose.position.{}",
    "TCP {}",
    "ee_pos_{}",
    "{}_RIst_act",
    "robot {}",
    "PosTCP{}",
    "tool{}",
]
JOINTS = ["joint_{}", "J{}", "q{}", "actual_joint_position_{}", "Axis{}", "joint{}_pos", "rax_{}"]
OVERRIDES = ["speed_scaling", "OV_PRO", "SpeedRatio", "override [%]", "speed_override"]


@st.composite
def tables(draw):
    """A table of a robot in words and numbers, and what it means in SI units."""
    mark = draw(st.sampled_from([",", ";", "\t"]))
    comma = mark != "," and draw(st.booleans())
    step = draw(st.sampled_from([0.004, 0.008, 0.02, 0.1]))
    t_s = [i * step for i in range(ROWS)]
    columns, truth = [], {}
    names, write, begin = TIMES[draw(st.sampled_from(sorted(TIMES)))]
    columns += list(zip(names, zip(*(write(t) for t in t_s), strict=True), strict=True))
    truth["t_s"] = [begin + t for t in t_s]
    length, suffix = draw(st.sampled_from([(1.0, ""), (1000.0, ""), (1.0, "_m"), (1000.0, " [mm]"), (1000.0, "_mm")]))
    place = draw(st.sampled_from(PLACES)) + suffix
    for at, axis in enumerate("xyz"):
        path = [0.5 + 0.2 * at + 0.003 * i + 1e-4 for i in range(ROWS)]
        columns.append((place.format(axis), [f"{length * v:.5f}" for v in path]))
        truth[f"tcp_{axis}_m"] = path
    if draw(st.booleans()):
        angle, first = draw(st.sampled_from([math.pi / 180, 1.0])), draw(st.sampled_from([0, 1]))
        name, count = draw(st.sampled_from(JOINTS)), draw(st.sampled_from([6, 7]))
        for at in range(count):
            turn = [0.3 * at - 1.0 + 0.005 * i + 1e-4 for i in range(ROWS)]
            columns.append((name.format(first + at), [f"{v / angle:.6f}" for v in turn]))
            truth[f"q{at}_rad"] = turn
    if draw(st.booleans()):
        name = draw(st.sampled_from(OVERRIDES))
        top = 100.0 if "%" in name else draw(st.sampled_from([1.0, 100.0]))
        share = [round(0.25 + 0.01 * i, 2) for i in range(ROWS)]
        columns.append((name, [f"{top * v:.6g}" for v in share]))
        truth["scaling"] = share
    if draw(st.booleans()):
        columns.append(("robot_state", ["RUNNING" if i < 40 else "paused" for i in range(ROWS)]))
        truth["state"] = ["playing" if i < 40 else "paused" for i in range(ROWS)]
    for name in draw(
        st.lists(st.sampled_from(["Fx", "target_x", "note", "temperature_1", "tool_voltage"]), unique=True)
    ):
        columns.append((name, ["ok" if name == "note" else f"{i % 7}.5" for i in range(ROWS)]))
    columns = draw(st.permutations(columns))
    rows = [
        mark.join(cells).replace(".", ",") if comma else mark.join(cells)
        for cells in zip(*(c for _, c in columns), strict=True)
    ]
    return mark.join(name for name, _ in columns) + "\n" + "\n".join(rows) + "\n", truth


@at_most(60, suppress_health_check=[HealthCheck.too_slow])
@given(tables())
def test_a_draft_without_doubt_reads_the_table_as_it_was_meant(tmp_path_factory, table):
    text, truth = table
    folder = tmp_path_factory.mktemp("draft")
    log = folder / "log.csv"
    proposed = draft(log, text)
    assert asked(proposed) == set(), text[:400]
    read = ingested(folder, proposed, log)
    assert read.robot.height == ROWS
    for column, meant in truth.items():
        got = read.robot[column].to_list()
        assert got == (meant if column == "state" else pytest.approx(meant, abs=2e-5)), column


def lines(*columns):
    names, cells = zip(*columns, strict=True)
    return "\n".join([",".join(names), *(",".join(map(str, row)) for row in zip(*cells, strict=True)), ""])


T = ("t_s", [0.01 * i for i in range(ROWS)])
MOVES = [0.2 + 0.004 * i for i in range(ROWS)]
TCP = [("tcp_x", MOVES), ("tcp_y", MOVES), ("tcp_z", MOVES)]
WHOLE = list(range(ROWS))


@pytest.mark.parametrize(
    ("columns", "unsure"),
    [
        ([T, ("x", MOVES), ("y", MOVES)], {"role"}),
        (
            [T, *((name, [10.5 + 0.1 * i for i in range(ROWS)]) for name in ("tcp_x", "tcp_y", "tcp_z"))],
            {"x", "y", "z", "length_unit"},
        ),
        ([("time", WHOLE), ("tcp_x", [0.5] * ROWS), ("tcp_y", MOVES)], {"time", "time_unit"}),
        ([("frame", WHOLE), *TCP], {"rate_hz"}),
        (TCP, {"rate_hz"}),
        ([T, *((f"q{i}", [0.01 * i] * ROWS) for i in range(6))], {"joints", "joint_unit"}),
        ([T, *TCP, ("override", [1] * ROWS)], {"scaling", "scaling_max"}),
        ([T, *TCP, ("robot_state", [1 + i % 3 for i in WHOLE])], {"state", "states"}),
        ([T, *((f"target_{axis}", MOVES) for axis in "xyz")], {"role", "x", "y", "z", "length_unit"}),
        (
            [T, *((f"{side}_tcp_{axis}", MOVES) for side in ("left", "right") for axis in "xyz")],
            {"x", "y", "z", "length_unit"},
        ),
        (
            [("time", [0.5 * i for i in WHOLE]), ("tcp_x", [0.25] * ROWS), ("tcp_y", [0.5] * ROWS)],
            {"time", "time_unit"},
        ),
        ([T, *((f"tcp_{axis}", [1000 * v / 4 for v in MOVES]) for axis in "xyz")], {"x", "y", "z", "length_unit"}),
        ([T, *((f"person_{axis}", [1000 * v for v in MOVES]) for axis in "xy")], {"x", "y", "length_unit"}),
        ([("time_us", [8 * i for i in WHOLE]), *TCP], {"time", "time_unit"}),
        ([T, *((f"position[{i}]", MOVES) for i in range(6))], {"role", "joints", "joint_unit"}),
        ([T, *((f"pose.position.{axis}", MOVES) for axis in "xyz")], {"role"}),
        ([("date", ["01/02/2024 10:00:00"] * ROWS), *TCP], {"time", "time_format"}),
    ],
)
def test_what_could_mean_something_else_is_asked_with_all_that_depends_on_it(tmp_path, columns, unsure):
    log = tmp_path / "log.csv"
    proposed = draft(log, lines(*columns))
    assert asked(proposed) == unsure
    source = written(tmp_path, proposed, log)
    assert unsure.isdisjoint(source.map)
    text = (tmp_path / "cell.toml").read_text()
    assert text.count("# ? ") == len(unsure)
    mended = "\n".join(line.removeprefix("# ? ") for line in text.splitlines())
    assert tomllib.loads(mended)["sources"][0]["adapter"] == "csv"


@pytest.mark.parametrize(
    ("called", "more"), [("log.csv", [("track_id", [1] * ROWS)]), ("people.csv", [])], ids=["by-column", "by-file"]
)
def test_a_table_of_people_is_in_metres_though_its_places_have_no_word_for_them(tmp_path, called, more):
    """Steps of 0.1 over 9 units: an arm could do that in mm, in cm or in inches; a person walks metres."""
    walk = [-3.5 + 0.09053 * i for i in range(100)]
    t = ("t_s", [0.07 * i for i in range(100)])
    table = lines(t, *((name, (told * 100)[:100]) for name, told in more), ("x", walk), ("y", walk))
    proposed = draft(tmp_path / called, table)
    assert asked(proposed) == set()
    assert (values(proposed)["role"], values(proposed)["length_unit"]) == ("people", "m")


def test_a_table_whose_time_is_in_doubt_is_not_read_until_somebody_decides(tmp_path):
    log = tmp_path / "log.csv"
    proposed = draft(log, lines(("time", WHOLE), ("tcp_x", [0.5] * ROWS), ("tcp_y", MOVES)))
    with pytest.raises(MissingColumns, match="time"):
        ingested(tmp_path, proposed, log)
    floor = draft(log, lines(T, ("x", MOVES), ("y", MOVES)))
    with pytest.raises(ConfigError, match="no role is given"):
        ingested(tmp_path, floor, log)


def test_whole_numbers_of_a_robot_in_motion_are_milliseconds_if_seconds_would_be_too_slow(tmp_path):
    log = tmp_path / "log.csv"
    proposed = draft(log, lines(("time", [8 * i for i in range(ROWS)]), *TCP))
    assert (values(proposed)["time_unit"], asked(proposed)) == ("ms", set())


def test_a_program_that_runs_or_not_is_a_state(tmp_path):
    log = tmp_path / "log.csv"
    proposed = draft(log, lines(T, *TCP, ("project_run", [i < 40 for i in WHOLE])))
    assert asked(proposed) == set()
    assert values(proposed)["states"] == {"True": "playing", "False": "stopped"}


def test_five_rows_a_second_are_seconds_if_milliseconds_would_be_too_fast(tmp_path):
    log = tmp_path / "log.csv"
    proposed = draft(
        log, lines(("time", [0.2 * i for i in WHOLE]), *((f"tcp_{a}", [0.02 * i for i in WHOLE]) for a in "xyz"))
    )
    assert (values(proposed)["time_unit"], asked(proposed)) == ("s", set())


def test_people_by_id_and_names_that_repeat(tmp_path):
    log = tmp_path / "log.csv"
    ids = [i % 2 for i in WHOLE]
    text = lines(
        ("time [s]", [0.1 * (i // 2) for i in WHOLE]), ("ped_id", ids), ("x", MOVES), ("y", MOVES), ("x", WHOLE)
    )
    proposed = draft(log, text)
    assert values(proposed)["role"] == "people"
    text = lines(
        ("time [s]", [0.1 * (i // 2) for i in WHOLE]), ("person_id", ids), ("head_x", MOVES), ("head_y", MOVES)
    )
    people = ingested(tmp_path, draft(log, text), log).people
    assert people["person"].unique().sort().to_list() == ["0", "1"]
    assert people["x_m"].to_list() == pytest.approx(MOVES)


def test_lists_in_cells_lines_above_the_header_and_latin_1(tmp_path):
    log = tmp_path / "log.csv"
    rows = [f'{0.01 * i:.2f};"[{0.3 + 0.001 * i}, -0.2, 0.5, 0, 3.1, 0]";süd' for i in WHOLE]
    proposed = draft(log, "\n".join(["Zelle Süd", "", "t;tcp_pose;Ort", *rows, ""]), encoding="latin-1")
    assert asked(proposed) == set()
    read = ingested(tmp_path, proposed, log)
    assert read.robot["tcp_x_m"].to_list() == pytest.approx([0.3 + 0.001 * i for i in WHOLE])
    assert read.set_aside.is_empty()


def test_a_comment_before_names_with_blanks_between(tmp_path):
    log = tmp_path / "log.txt"
    proposed = draft(
        log, "# time tcp_x tcp_y tcp_z\n" + "".join(f"{0.01 * i:.2f}  {v:.4f} 0.5 0.25\n" for i, v in enumerate(MOVES))
    )
    assert asked(proposed) == set()
    assert ingested(tmp_path, proposed, log).robot["tcp_x_m"].to_list() == pytest.approx(MOVES)


def test_a_table_without_names_is_proposed_by_numbers_and_asked_about(tmp_path):
    log = tmp_path / "log.csv"
    proposed = draft(log, "".join(f"{0.01 * i:.2f},{v:.4f},0.5\n" for i, v in enumerate(MOVES)))
    assert values(proposed)["columns"] == ["#1", "#2", "#3"]
    assert {"role", "time"} <= asked(proposed)


def test_a_second_line_of_units_says_the_units(tmp_path):
    log = tmp_path / "log.csv"
    rows = [f"{8 * i},{v},{v},{v}" for i, v in enumerate(range(10, 10 + ROWS))]
    proposed = draft(log, "\n".join(["time,tcp_x,tcp_y,tcp_z", "ms,mm,mm,mm", *rows, ""]))
    assert asked(proposed) == set()
    assert (values(proposed)["time_unit"], values(proposed)["length_unit"]) == ("ms", "mm")
    read = ingested(tmp_path, proposed, log)
    assert read.robot["tcp_x_m"][0] == pytest.approx(0.01)


def test_columns_of_two_states_become_signals(tmp_path):
    log, flips = tmp_path / "log.csv", [i // 9 % 2 for i in range(ROWS)]
    bits = [("di_curtain", [1] * ROWS), ("do_gripper", flips), ("Fx", ["0.00"] * ROWS), ("part", [1] * ROWS)]
    proposed = draft(log, lines(T, *((name, [f"{v:.4f}" for v in at]) for name, at in TCP), *bits))
    assert values(proposed)["tags"] == ["di_curtain", "do_gripper"]
    read = ingested(tmp_path, proposed, log)
    assert set(read.events["signal"]) == {"di_curtain", "do_gripper"}


def test_inputs_and_outputs_in_one_number_become_bits(tmp_path):
    log = tmp_path / "log.csv"
    words = [
        ("DI", [i // 9 % 2 << 4 for i in range(ROWS)]),
        ("Digital outputs", [i // 7 % 2 << 1 for i in range(ROWS)]),
    ]
    more = [("DI_speed", [f"{i}.5" for i in range(ROWS)]), ("inlet", [3] * ROWS)]
    proposed = draft(log, lines(T, *((name, [f"{v:.4f}" for v in at]) for name, at in TCP), *words, *more))
    assert (values(proposed)["digital_in"], values(proposed)["digital_out"]) == ("DI", "Digital outputs")
    read = ingested(tmp_path, proposed, log)
    assert set(read.robot["digital_in_bits"]) == {0, 16}


@pytest.mark.parametrize("content", [b"", b"the gripper squeaks\nand slips\n", b"\0\1\2\3", b"a,b,c\n", b"{}\n"])
def test_what_is_no_table_has_no_draft(tmp_path, content):
    log = tmp_path / "log.csv"
    log.write_bytes(content)
    assert ADAPTER.draft(log) is None


@pytest.mark.parametrize(
    ("names", "kinds", "meant"),
    [
        ("time_stamp " + " ".join(f"actual_tcp_position[{i}]" for i in range(6)), "s mm mm mm deg deg deg", "#2"),
        ("Time $POS_ACT.X $POS_ACT.Y $POS_ACT.Z $AXIS_ACT.A1 $OV_PRO", "s mm mm mm deg pct", "#2"),
        ("time " + " ".join(f"O_T_EE[{i}]" for i in range(16)), "s" + " m" * 16, "#14"),
        ("time joint1_cmd Fx robot_vx robot_x robot_y robot_z", "s rad m m m m m", "#5"),
        ("t human_x human_y human_z ur5_x ur5_y ur5_z", "s m m m m m m", "#5"),
        ("stamp tcp_target_x tcp_target_y tcp_target_z tcp_x tcp_y tcp_z", "s m m m m m m", "#5"),
    ],
)
def test_the_place_is_found_as_public_logs_name_it(tmp_path, names, kinds, meant):
    write = {
        "s": lambda i, at: 0.008 * i,
        "m": lambda i, at: 0.4 + 0.01 * at + 0.002 * i,
        "mm": lambda i, at: 400.5 + 10 * at + 2 * i,
        "deg": lambda i, at: 20.5 + at,
        "rad": lambda i, at: -1.5 + 0.01 * i,
        "pct": lambda i, at: 100,
    }
    kinds = kinds.split()
    rows = [" ".join(f"{write[kind](i, at):.4f}" for at, kind in enumerate(kinds)) for i in WHOLE]
    log = tmp_path / "log.txt"
    proposed = draft(log, "\n".join([names, *rows, ""]))
    place = names.split()[int(meant[1:]) - 1 :][:3]
    assert [values(proposed)[axis] for axis in "xyz"] == place
    assert asked(proposed) == set()
    assert ingested(tmp_path, proposed, log).robot["tcp_x_m"].null_count() == 0


FLIPS = [i // 9 % 2 for i in range(ROWS)]


@pytest.mark.parametrize("empty", [["error"], ["error", "note"]])
def test_an_empty_last_column_is_a_column(tmp_path, empty):
    """A logger that writes an error code only where there is one."""
    log = tmp_path / "log.csv"
    columns = [T, *TCP, *((name, ["E7" if i == 30 else "" for i in WHOLE]) for name in empty)]
    proposed = draft(log, lines(*columns))
    assert asked(proposed) == set()
    assert ingested(tmp_path, proposed, log).robot["tcp_x_m"].to_list() == pytest.approx(MOVES)


def test_rows_that_leave_out_their_last_cells_keep_the_names(tmp_path):
    log = tmp_path / "log.csv"
    rows = [f"{0.01 * i:.2f},{v:.4f},{v:.4f}{',E7' if i == 30 else ''}" for i, v in enumerate(MOVES)]
    proposed = draft(log, "\n".join(["t_s,tcp_x,tcp_y,error", *rows, ""]))
    assert asked(proposed) == set()
    read = ingested(tmp_path, proposed, log)
    assert (read.robot.height, read.set_aside["source_row"].to_list()) == (ROWS - 1, [32])


def test_of_series_with_a_time_each_those_of_the_first_time_are_read_and_the_others_named(tmp_path):
    log = tmp_path / "log.csv"
    later = [f"{0.5 * i:.1f}" if i < 20 else "" for i in WHOLE]
    bits = [str(bit) if i < 20 else "" for i, bit in enumerate(FLIPS)]
    text = lines(("Time", T[1]), ("warn_field", FLIPS), ("Time", later), ("door_closed", bits))
    proposed = draft(log, text)
    assert asked(proposed) == set()
    assert values(proposed) == {
        "role": "events", "delimiter": "comma", "time": "#1", "time_unit": "s", "tags": ["warn_field"],
    }  # fmt: skip
    assert any("door_closed" in note and "#3" in note for note in proposed.notes)
    changes = ingested(tmp_path, proposed, log).events["t_s"].to_list()
    assert changes == pytest.approx([0.01 * i for i in WHOLE if i == 0 or FLIPS[i] != FLIPS[i - 1]])


def plc(date="2024/05/14 06:30:{:02}", mark=","):
    rows = (f"{date.format(i)}{mark}{bit}{mark}{25 if bit else 100}{mark}" for i, bit in enumerate(FLIPS))
    return "\n".join([*rows, ""])


@pytest.mark.parametrize(
    ("above", "rows", "named"),
    [
        ('[LOGGING],PLC_1,2,3\nCell 7\nDATETIME[YYYY/MM/DD hh:mm:ss],BIT[1;0],SHORT[DEC.0],SHORT[DEC.0]\n'
         'TIME,X10_warn,M100_ovr,Trigger\n', plc(), ("TIME", "X10_warn", "M100_ovr")),
        ('" ","warn field","speed ovr"\n" ","none","%"\n" ","Scanner 1","Robot A"\n', plc(),
         ("#1", "warn field", "speed ovr")),
        ("Logger,Ver.1\nInterval,1,s\nCH,CH1,CH2\nKind,PLC,PLC\nItem,Scanner warn,Override\nUnit,-,%\nDate,,\n", plc(),
         ("Item", "Scanner warn", "Override")),
        ("[HEADER]\nDevice;S7\n[DATA]\nZeit;Warn;Ovr;\n", plc("14.05.2024 06:30:{:02}", ";"), ("Zeit", "Warn", "Ovr")),
        ("t [s]\tWarn\tOvr\n", plc("{}.5", "\t"), ("t [s]", "Warn", "Ovr")),
    ],
    ids=["types-above", "units-and-more", "labelled", "sections", "no-name-for-the-last"],
)  # fmt: skip
def test_of_several_lines_above_the_rows_the_one_of_different_words_has_the_names(tmp_path, above, rows, named):
    log = tmp_path / "log.csv"
    proposed = draft(log, above + rows)
    assert asked(proposed) == set()
    found = values(proposed)
    assert (found["time"], found["tags"][0], found["scaling"]) == named
    read = ingested(tmp_path, proposed, log)
    assert read.robot["scaling"].to_list() == [0.25 if bit else 1.0 for bit in FLIPS]
    assert read.set_aside.is_empty()


@pytest.mark.parametrize("mark", [";", ","])
def test_a_table_with_a_line_for_each_series_is_read_with_its_names_and_units(tmp_path, mark):
    log, decimal = tmp_path / "log.csv", "," if mark == ";" else "."
    told = [("Zeit", "ms", [f"{10 * i}.5" for i in WHOLE]), ("tcp X", "mm", [f"{400 + i}.5" for i in WHOLE]),
            ("tcp Y", "mm", ["250.5"] * ROWS), ("Warnfeld", "", map(str, FLIPS))]  # fmt: skip
    proposed = draft(log, "".join(mark.join([*line[:2], *line[2]]).replace(".", decimal) + "\n" for line in told))
    assert asked(proposed) == set()
    assert values(proposed)["tags"] == ["Warnfeld"]
    read = ingested(tmp_path, proposed, log)
    assert read.robot["t_s"].to_list() == pytest.approx([0.01 * i + 0.0005 for i in WHOLE])
    assert read.robot["tcp_x_m"].to_list() == pytest.approx([0.4005 + 0.001 * i for i in WHOLE])
    assert read.set_aside.is_empty()


def test_a_date_and_a_time_of_day_are_known_by_their_cells(tmp_path):
    log = tmp_path / "log.csv"
    rows = [f"2024/05/14,06:30:{i:02},{v:.4f},{v:.4f}" for i, v in enumerate(MOVES)]
    proposed = draft(log, "\n".join([",,tcp_x,tcp_y", *rows, ""]))
    assert values(proposed)["time"] == ["#1", "#2"]
    assert ingested(tmp_path, proposed, log).robot["t_s"][-1] == 1715668200 + ROWS - 1


@pytest.mark.parametrize(
    ("columns", "keys", "noted"),
    [
        ([(f"t{axis}", MOVES) for axis in "xyz"], {"x": "tx", "y": "ty", "z": "tz"}, ""),
        ([(f"left_{part}", MOVES) for part in ("s0", "s1", "e0", "e1", "w0", "w1", "w2")],
         {"joints": [f"left_{part}" for part in ("s0", "s1", "e0", "e1", "w0", "w1", "w2")]}, ""),
        ([("X [mm]", [f"1'{500 + i}.25" for i in WHOLE]), ("Y [mm]", MOVES)], {"x": ""}, "1'500.25"),
        ([("a", MOVES), ("b", MOVES)], {"x": ""}, ""),
    ],
    ids=["translation", "arm", "thousands", "nothing"],
)  # fmt: skip
def test_a_draft_that_maps_no_quantity_asks_for_it_and_says_what_may_be_it(tmp_path, columns, keys, noted):
    proposed = draft(tmp_path / "robot.csv", lines(T, *columns))
    assert {key: values(proposed)[key] for key in keys} == keys
    assert set(keys) <= asked(proposed)
    assert noted in "\n".join(proposed.notes)


def test_german_marks_of_thousands_do_not_make_the_comma_a_delimiter(tmp_path):
    rows = [f"0,{i:02};1.{500 + i},25;{150 + i},50" for i in WHOLE]
    proposed = draft(tmp_path / "robot.csv", "\n".join(["Zeit [s];X [mm];Y [mm]", *rows, ""]))
    assert (values(proposed)["delimiter"], values(proposed)["time"]) == ("semicolon", "Zeit [s]")
    assert any("1.500,25" in note for note in proposed.notes)


cells = st.one_of(
    st.floats(allow_nan=True).map(repr),
    st.integers(-(10**20), 10**20).map(str),
    st.sampled_from(
        ["", "nan", "[1, 2]", "[]", "x", "time", "1,5", "tcp_x", "#2", "#", "x#2", '"', "2024-05-01 10:00:00", "-"]
    ),
    st.text(st.characters(blacklist_categories=("Cs",)), max_size=6),
)


@at_most(150, suppress_health_check=[HealthCheck.too_slow])
@given(
    rows=st.lists(st.lists(cells, min_size=1, max_size=6), max_size=8),
    mark=st.sampled_from([",", ";", "\t", "|", " "]),
    end=st.sampled_from(["\n", "\r\n", ""]),
)
def test_whatever_a_table_holds_its_draft_is_a_cell_file(tmp_path_factory, rows, mark, end):
    folder = tmp_path_factory.mktemp("any")
    log = folder / "log.csv"
    proposed = draft(log, "\n".join(mark.join(row) for row in rows) + end)
    if proposed is not None:
        assert written(folder, proposed, log).adapter == "csv"
