"""Which adapter reads a file, which files are logs, and which recordings belong together."""

from __future__ import annotations

import threading
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from log_cards import log_card

from cyclekit.adapter import ReadOptions, Recording
from cyclekit.config import Cell, Source
from cyclekit.config.cells import Sync
from cyclekit.dataset.cards import LogCard, texts
from cyclekit.dataset.sessions import group_sessions, unpaired
from cyclekit.errors import ConfigError, LogError, UnknownName
from cyclekit.ingest.discover import find_all, matches
from cyclekit.ingest.registry import (
    SMALL_BYTES,
    Registered,
    adapter_named,
    adapters,
    find_adapter,
    find_logs,
    why_unknown,
)
from cyclekit.ingest.shared_logs import may_be_shared

if TYPE_CHECKING:
    from collections.abc import Iterator

TRIP = [("stand", 0.5), ("move", 0.3), ("stand", 0.5)]


def test_every_built_in_format_is_registered_with_a_line_that_describes_it():
    assert {"csv", "motive", "rosbag", "ur-rtde", "ur-split"} <= set(adapters())
    for name, entry in adapters().items():
        assert entry.name == name
        assert entry.package == "cyclekit"
        assert len(entry.summary) > 10


def test_an_adapter_that_does_not_exist_is_refused_with_the_nearest():
    with pytest.raises(UnknownName) as caught:
        adapter_named("motiv")
    assert caught.value.nearest == "motive"


def test_logs_are_known_by_their_content_whatever_they_are_called(tmp_path: Path, robot_log: Any, motive_log: Any):
    robot = robot_log(tmp_path / "monday.txt", TRIP)
    people = motive_log(tmp_path / "monday.dat", [(0.0, 0.0, 0.0)] * 3)
    assert [found.name for found in map(find_adapter, (robot, people)) if found] == ["ur-rtde", "motive"]


class _Telling:
    """An adapter whose parts say which thread made them."""

    def stream(self, path: Path, options: ReadOptions) -> Iterator[Any]:
        yield Recording(rows_read=threading.get_ident())

    def read(self, path: Path, options: ReadOptions) -> Any:
        return None

    def recognises(self, path: Path) -> bool:
        return True


def test_large_logs_alone_are_read_ahead_in_a_thread(tmp_path: Path):
    telling = Registered("telling", "other", "1", "says who reads", _Telling())  # type: ignore[arg-type]
    for name, size in (("small", 10), ("large", SMALL_BYTES)):
        (tmp_path / name).write_bytes(b"0" * size)
    read = {name: list(telling.parts(tmp_path / name, ReadOptions())) for name in ("small", "large")}
    assert [part.rows_read == threading.get_ident() for parts in read.values() for part in parts] == [True, False]


def test_hidden_files_below_a_folder_are_passed_over_and_a_hidden_folder_named_by_hand_is_not(
    tmp_path: Path, robot_log: Any
):
    robot_log(tmp_path / ".logs" / "run.csv", TRIP)
    robot_log(tmp_path / ".logs" / ".run.csv.swp", TRIP)
    assert list(find_logs(tmp_path)) == []
    assert [path.name for path, _ in find_logs(tmp_path / ".logs")] == ["run.csv"]


def test_logs_in_the_folder_above_are_found(tmp_path: Path, robot_log: Any, monkeypatch: pytest.MonkeyPatch):
    robot_log(tmp_path / "run.csv", TRIP)
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    found, _ = find_all([Path("..")], Cell())
    assert [log.shown for log in found] == ["run.csv"]


def test_two_logs_of_one_name_have_ids_of_their_own(tmp_path: Path, robot_log: Any):
    for name in ("run.csv", "run.txt", "a b/run.csv", "a_b/run.csv"):
        robot_log(tmp_path / name, TRIP)
    found, _ = find_all([tmp_path], Cell())
    assert len({log.id for log in found}) == 4
    assert all(set(log.id) <= set("abcdefghijklmnopqrstuvwxyz_.-0123456789") for log in found)


def test_the_same_file_given_twice_is_one_log(tmp_path: Path, robot_log: Any):
    log = robot_log(tmp_path / "run.csv", TRIP)
    found, _ = find_all([tmp_path, log], Cell())
    assert [entry.shown for entry in found] == ["run.csv"]


@pytest.mark.parametrize(
    ("pattern", "meant"),
    [
        ("a/run.csv", True),
        ("a", True),
        ("*/run.csv", True),
        ("*.csv", True),
        ("a/run[0-9].csv", False),
        ("run.csv", False),
        ("A/run.csv", False),
        ("/logs/a/run.csv", True),
    ],
)
def test_a_path_of_the_cell_file_is_a_file_a_folder_or_a_glob(pattern: str, meant: bool):
    assert matches("a/run.csv", Path("/logs/a/run.csv"), pattern) is meant


def test_the_first_source_that_means_a_log_is_its_source(tmp_path: Path, robot_log: Any):
    robot_log(tmp_path / "run.csv", TRIP)
    exact, every = Source("run.csv", body="1"), Source("*.csv", body="2")
    assert find_all([tmp_path], Cell(sources=(exact, every)))[0][0].source is exact
    assert find_all([tmp_path], Cell(sources=(every, exact)))[0][0].source is every


def test_a_folder_of_other_files_is_refused_and_names_some_with_the_reason(tmp_path: Path):
    for number in range(5):
        (tmp_path / f"note_{number}.txt").write_text("hello\nworld\n", encoding="utf-8")
    with pytest.raises(LogError, match=r"no log that can be read \(note_0.txt: no adapter .*; and 2 more\)"):
        find_all([tmp_path], Cell())


def names(*logs: LogCard) -> list[list[str]]:
    return [[log.id for log in session.logs] for session in group_sessions(logs, lambda shown: False)]


def test_one_robot_and_one_tracker_belong_together_wherever_they_lie():
    assert names(log_card("t/walk.csv", "people"), log_card("r/run.csv", "robot")) == [["r.run.csv", "t.walk.csv"]]


def test_with_several_robots_each_folder_is_a_session_with_the_robot_first():
    logs = [log_card(f"{day}/{name}", kind) for day in "ab" for name, kind in (("1", "people"), ("2", "robot"))]
    assert names(*logs) == [["a.2", "a.1"], ["b.2", "b.1"]]


def test_several_robots_alone_are_sessions_of_their_own():
    assert names(log_card("1.csv", "robot"), log_card("2.csv", "robot")) == [["1.csv"], ["2.csv"]]


def test_a_bag_that_holds_everything_is_a_session():
    assert names(*(log_card(f"{n}.bag", "robot", "people", "events") for n in range(2))) == [["0.bag"], ["1.bag"]]


def test_logs_in_folders_by_kind_belong_together_by_their_names():
    logs = [log_card(f"{kind}/{name}.csv", table) for kind, table in (("r", "robot"), ("t", "people")) for name in "ab"]
    assert names(*logs) == [["r.a.csv", "t.a.csv"], ["r.b.csv", "t.b.csv"]]
    days = [
        log_card(f"{day}/{kind}/run.csv", table) for day in "12" for kind, table in (("r", "robot"), ("t", "people"))
    ]
    assert names(*days) == [["1.r.run.csv", "1.t.run.csv"], ["2.r.run.csv", "2.t.run.csv"]]
    assert unpaired(group_sessions(logs + days, lambda shown: False)) == []


def test_where_names_do_not_tell_which_belong_together_it_is_said_with_the_cure():
    two_arms = [log_card("left/a.csv", "robot"), log_card("right/a.csv", "robot"), log_card("t/a.csv", "people")]
    other_names = [log_card("r/1.csv", "robot"), log_card("r/2.csv", "robot"), log_card("t/x.csv", "people")]
    for logs in (two_arms, other_names):
        sessions = group_sessions(logs, lambda shown: False)
        assert [len(session.logs) for session in sessions] == [1, 1, 1]
        (said,) = texts(unpaired(sessions))
        assert "unclear which belong together" in said
        assert "same name" in said
    empty = [log_card("r/1.csv", "robot"), log_card("r/2.csv", "robot")]
    assert unpaired(group_sessions(empty, lambda shown: False)) == []


def shared(*logs: LogCard, told: Source | None = None) -> list[list[str]]:
    share = partial(may_be_shared, sources={log.id: told for log in logs})
    return [[log.id for log in group.logs] for group in group_sessions(logs, lambda shown: False, shares=share)]


def test_events_since_1970_are_of_every_robot_log_that_they_meet_in_time():
    first, second = (
        log_card(f"{n}.csv", "robot", kind="epoch", first_s=t, last_s=t + 60) for n, t in (("1", 0), ("2", 90))
    )
    both = log_card("scanner.csv", "events", kind="epoch", first_s=30, last_s=100)
    late = log_card("late.csv", "events", kind="epoch", first_s=500, last_s=600)
    assert shared(first, second, both, late) == [["1.csv", "scanner.csv"], ["2.csv", "scanner.csv"], ["late.csv"]]


def test_events_of_another_clock_are_shared_where_the_cell_file_says_how_they_lie():
    logs = [log_card("1.csv", "robot"), log_card("2.csv", "robot"), log_card("plc.csv", "events")]
    with pytest.raises(ConfigError, match="2 robot logs and 1 others") as refusal:
        shared(*logs)
    assert "sync" in str(refusal.value.cure)
    told = Source("plc.csv", sync=Sync("digital-output 0", "gripper"))
    assert shared(*logs, told=told) == [["1.csv", "plc.csv"], ["2.csv", "plc.csv"]]


def at(path: str, table: str, first_s: float, last_s: float) -> LogCard:
    return log_card(path, table, kind="epoch", first_s=first_s, last_s=last_s)


def test_people_since_1970_are_beside_the_robot_of_their_time_whatever_names_and_folders_say():
    shifts = [
        at("r/early.csv", "robot", 0, 100),
        at("r/late.csv", "robot", 100, 200),
        at("r/next.csv", "robot", 900, 990),
    ]
    day, night = at("t/day.csv", "people", 0, 205), at("t/n.csv", "people", 880, 1000)
    hour = at("t/hour.csv", "people", 2000, 2100)
    parted = [["r.early.csv", "t.day.csv"], ["r.late.csv", "t.day.csv"], ["r.next.csv", "t.n.csv"], ["t.hour.csv"]]
    assert shared(*shifts, day, night, hour) == parted
    flat = [
        log_card(Path(log.shown).name, log.tables[0], kind="epoch", first_s=log.first_s, last_s=log.last_s)
        for log in (*shifts, day, night, hour)
    ]
    assert shared(*flat) == [[name.split(".", 1)[1] for name in group] for group in parted]


def test_two_robots_at_once_leave_it_unclear_whose_people_these_are():
    arms = [at("left/a.csv", "robot", 0, 100), at("right/b.csv", "robot", 50, 150)]
    seen = at("t/c.csv", "people", 0, 150)
    assert shared(*arms, seen) == [["left.a.csv"], ["right.b.csv"], ["t.c.csv"]]
    with pytest.raises(ConfigError, match="unclear which belong") as refusal:
        shared(at("1.csv", "robot", 0, 100), at("2.csv", "robot", 50, 150), at("3.csv", "people", 0, 150))
    assert "a dataset of each: cyclekit ingest 1.csv 3.csv --out DATASET" in str(refusal.value.cure)
    far = Source("t/c.csv", clock_offset_s=3600.0)
    one = [at("r/a.csv", "robot", 0, 100), at("r/b.csv", "robot", 200, 300)]
    assert shared(*one, seen, told=far) == [["r.a.csv"], ["r.b.csv"], ["t.c.csv"]]


@pytest.mark.parametrize(("robot", "people"), [("{}_robot", "{}_take"), ("r/{}_robot", "t/TAKE {}"), ("UR_{}", "{}")])
def test_logs_belong_together_by_the_words_of_their_names(robot: str, people: str):
    shifts = ["shift_01_anna", "shift_02_ben", "shift_03_anna"]
    robots = [log_card(f"{robot.format(shift)}.csv", "robot") for shift in shifts]
    tracked = [log_card(f"{people.format(shift.replace('_0', '-'))}.csv", "people") for shift in shifts[:2]]
    assert names(*robots, *tracked) == [[robots[0].id, tracked[0].id], [robots[1].id, tracked[1].id], [robots[2].id]]
    assert names(*robots, *reversed(tracked)) == names(*robots, *tracked)


def test_logs_of_several_kinds_beside_each_robot_belong_together_by_their_names():
    kinds = {"robot": "robot", "override": "events", "person": "people"}
    logs = [log_card(f"run_{n}_ada_{kind}.csv", table) for n in (1, 2, 3) for kind, table in kinds.items()]
    grouped = [sorted(group) for group in names(*logs)]
    assert grouped == [[f"run_{n}_ada_{kind}.csv" for kind in ("override", "person", "robot")] for n in (1, 2, 3)]
    other_day = [
        log_card(f"0{day}_run_{n}_{kind}.csv", kind) for day, kind in ((4, "robot"), (5, "people")) for n in "12"
    ]
    with pytest.raises(ConfigError, match="unclear which belong"):
        names(*other_day, log_card("06_run_1_events.csv", "events"))


def test_words_that_fit_two_robots_or_none_or_another_time_match_nothing():
    for robots, people in ((("a_1_r", "b_1_r"), ("1_t", "2_t")), (("1_r", "2_r"), ("1_t", "3_t"))):
        logs = [log_card(f"{name}.csv", "robot") for name in robots] + [log_card(f"{n}.csv", "people") for n in people]
        with pytest.raises(ConfigError, match="unclear which belong") as refusal:
            names(*logs)
        assert "shift_1_robot.csv" in str(refusal.value.cure)
    late = [at("1_t.csv", "people", 500, 600), at("2_t.csv", "people", 700, 800)]
    with pytest.raises(ConfigError, match="unclear which belong"):
        names(at("1_r.csv", "robot", 0, 100), at("2_r.csv", "robot", 200, 300), *late)


def test_two_robots_and_a_tracker_in_one_folder_are_refused():
    with pytest.raises(ConfigError, match="2 robot logs and 1 others"):
        names(log_card("1.csv", "robot"), log_card("2.csv", "robot"), log_card("3.csv", "people"))


def test_sessions_are_named_after_their_folder_or_their_log_and_never_alike():
    logs = [log_card("day/a/run.csv", "robot"), log_card("day/b/run.csv", "robot"), log_card("run.csv", "robot")]
    sessions = group_sessions(logs, lambda shown: shown.startswith("day/b"))
    assert [session.name for session in sessions] == ["day.a", "day.b", "run.csv"]
    assert [session.reference for session in sessions] == [False, True, False]


def test_a_file_of_a_log_that_is_a_folder_points_at_the_folder(tmp_path: Path):
    folder = tmp_path / "movement"
    folder.mkdir()
    rows = "".join(f"{0.008 * i:.3f}, 0.1, 0.2, 0.3, 0, 0, 0\n" for i in range(5))
    for name in ("log_tool_vector.csv", "log_q_actual.csv"):
        (folder / name).write_text(rows)
    said = str(why_unknown(folder / "log_q_actual.csv"))
    assert "part of the folder 'movement', which is one log of adapter 'ur-split'" in said
    assert "Name the folder" in said
