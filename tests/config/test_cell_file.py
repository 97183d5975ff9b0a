"""The cell file: every key arrives, every slip is refused with the nearest right thing, and it can be written back."""

from __future__ import annotations

import math
import string
from datetime import UTC
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from cyclekit.config import Cell, Executions, Frame, Furniture, NamedPlace, Source, Sync, Wait, cell_to_toml, load_cell
from cyclekit.errors import ConfigError, UnknownName
from cyclekit.text.plain_text import one_line

EVERYTHING = """
name = "line 4"
ignore = ["truth/*", "*.bak"]
reference = ["empty/*.csv"]
rate_hz = 20
bridge_s = 0.5
levels = [0, 0.5, 1.0]

[[sources]]
path = "tracker/*.csv"
adapter = "motive"
role = "people"
clock_offset_s = 12
clock_rate = 1.00005
frame = { xyz_m = [1, 2.5, -0.8], yaw_deg = 90 }
body = "Operator"
rate_hz = 120.0
map = { time = "t", columns = ["a", "b"] }

[places.conveyor]
xyz_m = [0.6, 0, 0.1]
radius_m = 0.02

[human_places."left table"]
xyz_m = [0.0, 1.5, 0.2]

[furniture.bench]
xyz_m = [0.0, 1.2, -0.05]
size_m = [0.9, 0.35, 0.7]
yaw_deg = 30

[executions]
begin = "digital-output"
gap_s = 5
home = "conveyor"
bit = 3
"""


def written(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "cell.toml"
    path.write_text(text, encoding="utf-8")
    return path


def test_every_key_of_a_cell_file_arrives(tmp_path: Path):
    cell = load_cell(written(tmp_path, EVERYTHING))
    assert (cell.name, cell.ignore, cell.reference) == ("line 4", ("truth/*", "*.bak"), ("empty/*.csv",))
    assert (cell.rate_hz, cell.bridge_s, cell.levels) == (20.0, 0.5, (0.0, 0.5, 1.0))
    (source,) = cell.sources
    assert (source.path, source.adapter, source.role, source.body) == ("tracker/*.csv", "motive", "people", "Operator")
    assert (source.clock_offset_s, source.clock_rate, source.rate_hz) == (12.0, 1.00005, 120.0)
    assert source.map == {"time": "t", "columns": ["a", "b"]}
    assert source.frame is not None
    assert source.frame.xyz_m == (1.0, 2.5, -0.8)
    assert cell.places == {"conveyor": NamedPlace((0.6, 0.0, 0.1), 0.02)}
    assert cell.human_places == {"left table": NamedPlace((0.0, 1.5, 0.2), 0.05)}
    assert cell.furniture == {"bench": Furniture((0.0, 1.2, -0.05), (0.9, 0.35, 0.7), 30.0)}
    assert cell.executions == Executions("digital-output", 5.0, "conveyor", 3)


CLOCKS = """
[[sources]]
path = "gripper.csv"
sync = { robot = "digital-output 3", other = "sync_in=1" }

[[sources]]
path = "flange.csv"
sees = "tcp"
sees_as = "Flange"

[[sources]]
path = "operator.csv"
same_clock_as = "flange.csv"

[[sources]]
path = "kinect.json"
sync_events = [[1.5, 101.5], [61, 161.003]]

[[sources]]
path = "qualisys.tsv"
start = 2026-03-02T14:03:11+01:00
"""


def test_every_way_to_relate_a_clock_arrives(tmp_path: Path):
    events, flange, operator, kinect, qualisys = load_cell(written(tmp_path, CLOCKS)).sources
    assert events.sync == Sync("digital-output 3", "sync_in=1")
    assert (flange.sees, flange.sees_as) == ("tcp", "Flange")
    assert operator.same_clock_as == "flange.csv"
    assert kinect.sync_events == ((1.5, 101.5), (61.0, 161.003))
    assert qualisys.start == "2026-03-02T14:03:11+01:00"


def test_an_empty_cell_file_is_a_cell_with_the_defaults_named_after_its_folder(tmp_path: Path):
    assert load_cell(written(tmp_path, "")) == Cell(name=tmp_path.name)


def test_a_tracker_turned_by_90_degrees_has_its_x_axis_along_the_y_axis_of_the_base(tmp_path: Path):
    source = load_cell(written(tmp_path, EVERYTHING)).sources[0]
    assert source.frame is not None
    turned = np.array(source.frame.rotation) @ [1.0, 0.0, 0.0]
    np.testing.assert_allclose(turned, [0.0, 1.0, 0.0], atol=1e-12)


@pytest.mark.parametrize("yaw_deg", [0.0, 35.0, -120.0, 180.0])
def test_yaw_and_rotation_say_the_same_frame(tmp_path: Path, yaw_deg: float):
    c, s = math.cos(math.radians(yaw_deg)), math.sin(math.radians(yaw_deg))
    rows = f"[[{c}, {-s}, 0.0], [{s}, {c}, 0.0], [0.0, 0.0, 1.0]]"
    by_yaw = load_cell(written(tmp_path, f'sources = [{{ path = "a", frame = {{ yaw_deg = {yaw_deg} }} }}]'))
    by_rows = load_cell(written(tmp_path, f'sources = [{{ path = "a", frame = {{ rotation = {rows} }} }}]'))
    assert by_yaw.sources[0].frame is not None
    assert by_rows.sources[0].frame is not None
    np.testing.assert_allclose(by_yaw.sources[0].frame.rotation, by_rows.sources[0].frame.rotation, atol=1e-15)


@pytest.mark.parametrize(
    ("text", "near"),
    [
        ('ignored = ["x"]', "ignore"),
        ('sources = [{ path = "a", adaptor = "csv" }]', "adapter"),
        ('sources = [{ path = "a", role = "robots" }]', "robot"),
        ('sources = [{ path = "a", frame = { xyz = [0, 0, 0] } }]', "xyz_m"),
        ("[places.home]\nxyz_m = [0, 0, 0]\nradius = 0.1", "radius_m"),
        ("[human_places.home]\nxyzm = [0, 0, 0]", "xyz_m"),
        ("[executions]\ngap = 2", "gap_s"),
        ('[executions]\nbegin = "registers"', "register"),
        ('sources = [{ path = "a", sees = "tpc" }]', "tcp"),
        ('sources = [{ path = "a", sync = { robot = "register", others = "b" } }]', "other"),
    ],
)
def test_a_name_that_is_not_known_is_refused_with_the_nearest(tmp_path: Path, text: str, near: str):
    path = written(tmp_path, text)
    with pytest.raises(UnknownName) as caught:
        load_cell(path)
    assert caught.value.nearest == near
    assert str(path) in str(caught.value)


@pytest.mark.parametrize(
    "text",
    [
        "name = 4",
        'ignore = "truth/*"',
        "rate_hz = 0",
        "rate_hz = true",
        'rate_hz = "10"',
        'bridge_s = "long"',
        "bridge_s = nan",
        "levels = 3",
        "levels = [1.0]",
        "levels = [1.0, 0.5]",
        "levels = [0.5, 0.5]",
        'levels = ["0", "1"]',
        "levels = [0.0, 50]",
        "sources = 3",
        "sources = [3]",
        'sources = [{ role = "robot" }]',
        "sources = [{ path = 3 }]",
        'sources = [{ path = "a", body = 3 }]',
        'sources = [{ path = "a", rate_hz = -1 }]',
        'sources = [{ path = "a", clock_rate = 0 }]',
        'sources = [{ path = "a", clock_offset_s = "12" }]',
        'sources = [{ path = "a", map = { x = nan } }]',
        'sources = [{ path = "a", map = { x = [2026-01-01] } }]',
        "rate_hz = 1e9",
        "places = { home = { xyz_m = [1e300, 0, 0] } }",
        'sources = [{ path = "a", clock_offset_s = inf }]',
        'sources = [{ path = "a", map = "t" }]',
        'sources = [{ path = "a", sync = "register" }]',
        'sources = [{ path = "a", sync = { robot = "register" } }]',
        'sources = [{ path = "a", sync = { robot = 3, other = "b" } }]',
        'sources = [{ path = "a", sync_events = [[1, 2, 3]] }]',
        'sources = [{ path = "a", sync_events = [["1", 2]] }]',
        'sources = [{ path = "a", sync_events = 3 }]',
        'sources = [{ path = "a", same_clock_as = 3 }]',
        'sources = [{ path = "a", sees_as = "Flange" }]',
        "furniture = { bench = { xyz_m = [0, 0, 0], size_m = [1, 0, 1] } }",
        "furniture = { bench = { xyz_m = [0, 0, 0] } }",
        "furniture = { bench = { xyz_m = [0, 0, 0], size_m = [1, 1, 1], yaw_deg = 'left' } }",
        '[executions]\nbegin = "signal"',
        '[executions]\nsignal = "cycle_start"',
        'sources = [{ path = "a", sees = "tcp", clock_offset_s = 3 }]',
        'sources = [{ path = "a", sees = "tcp", clock_rate = 1.1 }]',
        'sources = [{ path = "a", same_clock_as = "b", sync_events = [[1, 2]] }]',
        'sources = [{ path = "a", start = "2026-03-02T14:03:11" }]',
        'sources = [{ path = "a", start = "yesterday" }]',
        'sources = [{ path = "a", start = 3 }]',
        'sources = [{ path = "a", frame = 3 }]',
        'sources = [{ path = "a", frame = { yaw_deg = "north" } }]',
        'sources = [{ path = "a", frame = { xyz_m = [0, 0] } }]',
        'sources = [{ path = "a", frame = { xyz_m = [0, 0, nan] } }]',
        'sources = [{ path = "a", frame = { rotation = [[1, 0, 0], [0, 1, 0], [0, 0, -1]] } }]',
        'sources = [{ path = "a", frame = { rotation = [[1, 0, 0], [0, 1, 0]] } }]',
        'sources = [{ path = "a", frame = { yaw_deg = 3, rotation = [[1, 0, 0], [0, 1, 0], [0, 0, 1]] } }]',
        "places = 3",
        "[places]\nhome = 3",
        "[places.home]\nradius_m = 0.1",
        "[places.home]\nxyz_m = 3",
        "[places.home]\nxyz_m = [0, 0, 0]\nradius_m = 0",
        "executions = 3",
        '[executions]\ngap_s = "long"',
        "[executions]\nhome = 3",
        "[executions]\nbit = -1",
        "[executions]\nbegin = 3",
        "this is no TOML",
    ],
)
def test_a_value_of_the_wrong_kind_is_refused_and_the_file_named(tmp_path: Path, text: str):
    path = written(tmp_path, text)
    with pytest.raises(ConfigError) as caught:
        load_cell(path)
    assert str(path) in caught.value.seen
    assert caught.value.cure


def test_a_cell_file_that_is_not_there_is_refused(tmp_path: Path):
    with pytest.raises(ConfigError, match="cannot be read"):
        load_cell(tmp_path / "nowhere.toml")


NUMBER = st.floats(-1e4, 1e4)
POSITIVE = st.floats(1e-6, 1e4)
TEXT = st.text(st.characters(exclude_categories=["Cs"]), max_size=8) | st.text(string.printable, min_size=1, max_size=8)
TEXT = TEXT.map(one_line)  # as every name is read
POINT = st.tuples(NUMBER, NUMBER, NUMBER)
YAW = st.floats(-math.pi, math.pi).map(
    lambda a: ((math.cos(a), -math.sin(a), 0.0), (math.sin(a), math.cos(a), 0.0), (0.0, 0.0, 1.0))
)
PLACES = st.dictionaries(TEXT, st.builds(NamedPlace, POINT, st.floats(1e-6, 100)), max_size=3)
INSTANT = st.datetimes(timezones=st.just(UTC)).map(lambda when: when.isoformat())
CLOCK = st.one_of(
    st.fixed_dictionaries({}, optional={"clock_offset_s": NUMBER, "clock_rate": st.floats(0.1, 10)}),
    st.fixed_dictionaries({"sync": st.builds(Sync, TEXT, TEXT)}),
    st.fixed_dictionaries({"sync_events": st.lists(st.tuples(NUMBER, NUMBER), min_size=1, max_size=3).map(tuple)}),
    st.fixed_dictionaries({"sees": st.just("tcp")}, optional={"sees_as": TEXT}),
    st.fixed_dictionaries({"same_clock_as": TEXT}, optional={"start": INSTANT}),
)
SOURCE = st.builds(
    lambda clock, **others: Source(**clock, **others),
    CLOCK,
    path=TEXT,
    adapter=st.none() | TEXT,
    role=st.sampled_from([None, "robot", "people", "events"]),
    frame=st.none() | st.builds(Frame, POINT, YAW),
    body=st.none() | TEXT,
    rate_hz=st.none() | st.floats(1e-3, 1e6),
    map=st.dictionaries(TEXT, TEXT | st.booleans() | st.lists(TEXT, max_size=2), max_size=2),
)
CELL = st.builds(
    Cell,
    name=TEXT.filter(bool),
    sources=st.lists(SOURCE, max_size=3).map(tuple),
    ignore=st.lists(TEXT, max_size=2).map(tuple),
    reference=st.lists(TEXT, max_size=2).map(tuple),
    places=PLACES,
    human_places=PLACES,
    furniture=st.dictionaries(
        TEXT, st.builds(Furniture, POINT, st.tuples(POSITIVE, POSITIVE, POSITIVE), NUMBER), max_size=2
    ),
    executions=st.builds(
        Executions,
        begin=st.sampled_from(["auto", "file", "gap", "home", "register", "digital-output"]),
        gap_s=POSITIVE,
        home=st.none() | TEXT.filter(bool),
        bit=st.integers(0, 62),
    )
    | st.builds(Executions, begin=st.just("signal"), signal=TEXT.filter(bool)),
    rate_hz=st.floats(0.1, 1000),
    bridge_s=st.floats(0, 3600),
    goal_signals=st.lists(TEXT, max_size=2).map(tuple),
    accept_bad_logs=st.booleans(),
    align_clocks=st.sampled_from([None, "logs"]),
    levels=st.just(()) | st.lists(st.floats(0, 1), min_size=2, max_size=5, unique=True).map(sorted).map(tuple),
)


@settings(deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(CELL)
def test_a_cell_written_as_toml_reads_back_as_the_same_cell(tmp_path: Path, cell: Cell):
    path = tmp_path / "cell.toml"
    path.write_text(cell_to_toml(cell), encoding="utf-8", newline="")
    assert load_cell(path) == cell


def test_who_waits_for_whom_can_be_told_and_written_back(tmp_path: Path) -> None:
    text = """
[[waits]]
agent = "robot"
before = "fixture"
until = "operator leaves fixture 2"
back = 1

[[waits]]
agent = "operator"
leaving = "bench"
never = true

[[waits]]
agent = "operator"
before = "bench"
until = "digital-input 3 cleared"

[[waits]]
agent = "operator"
spot = "aside"
never = true

[[waits]]
agent = "robot"
task = "weld"
until = "mount"
never = true
"""
    cell = load_cell(written(tmp_path, text))
    first, second, third, spot, task = cell.waits
    assert spot == Wait("operator", spot="aside", never=True)
    assert (task.task, task.until, task.event) == ("weld", "mount", None)
    assert first == Wait("robot", before="fixture", until="operator leaves fixture 2", back=1)
    assert first.event == ("operator", "fixture 2", "leaves")
    assert second.event is None
    assert third.event == ("signal", "digital-input 3", "cleared")
    assert load_cell(written(tmp_path, cell_to_toml(cell))).waits == cell.waits


@pytest.mark.parametrize(
    ("said", "seen"),
    [
        ('until = "operator leaves a"', "one of before, leaving, spot and task"),
        ('before = "a"\nleaving = "b"\nuntil = "operator leaves a"', "one of before, leaving, spot and task"),
        ('before = "a"\nspot = "b"\nnever = true', "one of before, leaving, spot and task"),
        ('spot = "a"', "spot tells only that nobody waits there"),
        ('spot = "a"\nnever = true', "tells that the operator works there"),
        ('task = "a"\nuntil = "b"', "task tells only that nobody waits there, or for that"),
        ('task = "a"\nback = 1\nnever = true', "in any passage"),
        ('before = "a"', "no until: what does it wait for?"),
        ('before = "a"\nuntil = "operator sings"', "is not an event"),
        ('before = "a"\nuntil = "robot leaves a"', "waits for itself"),
    ],
)
def test_a_wait_that_cannot_be_meant_is_refused_with_its_cure(tmp_path: Path, said: str, seen: str) -> None:
    with pytest.raises(ConfigError, match=seen) as refused:
        load_cell(written(tmp_path, f'[[waits]]\nagent = "robot"\n{said}'))
    assert "waits[0]" in str(refused.value)
    assert refused.value.cure
