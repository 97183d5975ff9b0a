"""What cannot be is found and named, what is set aside is listed, and one writer at a time is at work."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import polars as pl
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cyclekit.adapter import Recording, whole
from cyclekit.atomic import locked, replaced, staged, write_parquet, write_text
from cyclekit.dataset import Dataset
from cyclekit.describe import describe
from cyclekit.errors import BusyPlace, CyclekitError
from cyclekit.ingest import ingest
from cyclekit.plausible import examined, examined_parts
from cyclekit.schema import PEOPLE, QUARANTINE, ROBOT, conform
from cyclekit_sim import SimulationOptions, simulate

if TYPE_CHECKING:
    from collections.abc import Iterator

ROUND_TRIP = [("stand", 0.5), ("move", 0.3), ("stand", 0.6), ("move", 0.0), ("stand", 0.5)]


def robot(rows: int = 300, **columns: Any) -> Recording:
    """A robot that goes to and fro at 125 Hz, with some of its columns replaced."""
    t = np.arange(rows) / 125
    made = {
        "t_s": t,
        "tcp_x_m": 0.3 + 0.2 * np.sin(t),
        "tcp_y_m": 0.1 * np.cos(t),
        "tcp_z_m": 0.0 * t + 0.4,
        "source_row": np.arange(rows),
    }
    return Recording(robot=conform(pl.DataFrame(made | columns), ROBOT), rows_read=rows)


def walk(rows: int = 200, person: str = "7", x: Any = None) -> pl.DataFrame:
    t = np.arange(rows) / 30
    x = 1.0 + 0.5 * np.sin(t) if x is None else x
    columns = {"t_s": t, "person": [person] * rows, "x_m": x, "y_m": 2.0 + 0.01 * t, "z_m": 0.0 * t + 1.0}
    return conform(pl.DataFrame({**columns, "source_row": np.arange(rows)}), PEOPLE)


def with_value(column: pl.Series, row: int, value: float) -> pl.Series:
    values = column.to_list()
    values[row] = value
    return pl.Series(column.name, values)


def aside(log: Recording) -> list[tuple[int, str]]:
    return [] if log.set_aside is None else log.set_aside.rows()


def test_a_sound_recording_is_left_as_it_is():
    log = robot()
    found = examined(log)
    assert found.robot.equals(log.robot)
    assert (found.warnings, aside(found)) == ((), [])
    people = Recording(people=pl.concat([walk(person="a"), walk(person="b")]))
    assert examined(people).people.equals(people.people)
    assert examined(people).warnings == ()


@pytest.mark.parametrize(
    ("value", "reason"),
    [
        (float("nan"), "its time is no number that a clock shows"),
        (float("inf"), "its time is no number that a clock shows"),
        (99 / 125, "repeats the time of the row before it"),
        (50 / 125, "its time does not fit between its neighbours"),
        (1e9, "its time does not fit between its neighbours"),
        (-3.0, "its time does not fit between its neighbours"),
    ],
)
def test_a_row_whose_time_cannot_be_is_set_aside_alone(value: float, reason: str):
    log = robot()
    found = examined(robot(t_s=with_value(log.robot["t_s"], 100, value)))
    assert aside(found) == [(100, reason)]
    assert found.robot.height == 299


def test_a_restarted_clock_is_no_stray_row():
    t = np.concatenate([np.arange(150), np.arange(150)]) / 125
    found = examined(robot(t_s=t))
    assert (found.robot.height, aside(found)) == (300, [])


def test_a_clock_that_was_set_while_recording_is_named():
    t = np.arange(300) / 125 + np.where(np.arange(300) < 200, 0.0, 1.7e9)
    (said,) = examined(robot(t_s=t)).warnings
    assert "jumps ahead by 19675.9 days" in said


def test_nan_and_infinite_values_become_unknown_and_are_counted():
    log = robot()
    x = with_value(with_value(log.robot["tcp_x_m"], 3, float("nan")), 4, float("inf"))
    found = examined(robot(tcp_x_m=x))
    assert found.robot["tcp_x_m"].null_count() == 2
    assert found.warnings == ("NaN or infinite: tcp_x_m in 2 rows; unknown there",)


@pytest.mark.parametrize("value", [1.5, -0.9, 1e3, 1e300])
def test_a_tcp_that_jumps_there_and_back_is_set_aside(value: float):
    log = robot()
    found = examined(robot(tcp_x_m=with_value(log.robot["tcp_x_m"], 77, value)))
    assert [row for row, _ in aside(found)] == [77]
    assert "the TCP" in aside(found)[0][1]


@pytest.mark.parametrize("value", [5.0, -300.0])
def test_an_operator_at_20_m_s_is_set_aside_and_the_others_of_that_row_are_kept(value: float):
    other = walk(person="b")
    people = pl.concat([walk(person="a", x=with_value(walk()["x_m"], 50, value)), other])
    found = examined(Recording(people=people))
    assert [row for row, _ in aside(found)] == [50]
    assert found.people.filter(pl.col("person") == "b").equals(other)


def test_a_track_that_changes_its_person_is_named_and_kept():
    x = walk()["x_m"].to_numpy() + np.where(np.arange(200) < 100, 0.0, 6.0)
    found = examined(Recording(people=walk(x=x)))
    assert found.people.height == 200
    assert found.warnings == ("a person jumps faster than 20 m/s 1 time(s): a track that changed its person",)


def test_jitter_of_the_clock_makes_no_jump():
    t = np.arange(300) / 125
    t[100] += 0.0079  # the next row comes 0.1 ms later, 8 mm farther
    found = examined(robot(t_s=t, tcp_x_m=t))
    assert (found.warnings, aside(found)) == ((), [])


def test_millimetres_read_as_metres_are_named_with_the_cure_and_not_mended():
    log = robot(tcp_x_m=1000 * robot().robot["tcp_x_m"])
    found = examined(log)
    assert "likely millimetres" in found.warnings[0]
    assert found.robot.height == 300
    people = examined(Recording(people=walk(x=1400.0 + walk()["x_m"])))
    assert people.warnings[0].startswith("a person is 1401 m away in 200 rows: likely millimetres")


@pytest.mark.parametrize(
    ("column", "values", "said"),
    [
        ("scaling", np.linspace(0, 100, 300), "scaling reaches 100 in 297 rows: likely percent, say scaling_max = 100"),
        ("tcp_speed_m_s", np.linspace(0, 400, 300), "likely mm/s"),
        ("q1_rad", np.linspace(-90, 90, 300), 'likely degrees; say joint_unit = "deg"'),
        ("t_s", np.arange(300) * 8.0, "milliseconds taken for seconds"),
    ],
)
def test_a_slip_of_units_is_named_with_the_cure(column: str, values: Any, said: str):
    assert any(said in text for text in examined(robot(**{column: values})).warnings)


def test_a_tcp_that_never_moves_by_a_hair_is_named():
    same = {f"tcp_{axis}_m": [0.0] * 300 for axis in "xyz"}
    assert examined(robot(**same)).warnings == (
        "the TCP stays at exactly (0, 0) m in all 300 rows: is the right signal logged?",
    )
    assert examined(robot(50, **{name: values[:50] for name, values in same.items()})).warnings == ()


@given(
    st.lists(st.tuples(*[st.one_of(st.none(), st.floats())] * 5), max_size=25),
    st.lists(st.tuples(st.one_of(st.none(), st.floats()), st.sampled_from([None, "a", "b"]), st.floats()), max_size=15),
)
def test_any_numbers_at_all_are_kept_or_set_aside(rows: list[Any], tracks: list[Any]):
    columns = ("t_s", "tcp_x_m", "tcp_y_m", "scaling", "tcp_speed_m_s")
    frame = pl.DataFrame(rows, schema=dict.fromkeys(columns, pl.Float64()), orient="row").with_row_index("source_row")
    log = Recording(robot=conform(frame, ROBOT), rows_read=len(rows))
    found = examined(log)
    assert found.robot.height + len(aside(found)) == len(rows)
    assert found.robot["t_s"].is_finite().all()
    seen = {"t_s": pl.Float64(), "person": pl.String(), "x_m": pl.Float64()}
    people = conform(pl.DataFrame(tracks, schema=seen, orient="row").with_row_index("source_row"), PEOPLE)
    found = examined(Recording(people=people))
    assert found.people.height + len(aside(found)) == len(tracks)


@pytest.fixture
def logs(tmp_path: Path, robot_log: Any) -> Path:
    """Two logs, one of which was cut in its last line."""
    whole = robot_log(tmp_path / "logs" / "a.csv", ROUND_TRIP)
    cut = robot_log(tmp_path / "logs" / "b.csv", ROUND_TRIP)
    cut.write_bytes(cut.read_bytes()[:-9])
    assert whole.is_file()
    return tmp_path / "logs"


def test_every_row_set_aside_is_in_one_table_with_file_line_and_reason(logs: Path, tmp_path: Path):
    found = Dataset.open(ingest([logs], tmp_path / "dataset").dataset)
    table = found.quarantine()
    assert table.schema == pl.Schema({name: column.dtype for name, column in QUARANTINE.items()})
    last = len((logs / "b.csv").read_bytes().splitlines())
    assert table.rows() == [
        ("b", "b.csv", last, "line", "the last line has no line end: it was cut while being written")
    ]
    assert sorted(file.name for file in (found.path / "recordings" / "b").iterdir()) == ["robot.parquet"]
    assert sum(describe(found.path).set_aside.values()) == 1


def test_what_was_set_aside_stays_listed_when_its_log_is_not_read_again(logs: Path, tmp_path: Path, robot_log: Any):
    out = ingest([logs], tmp_path / "dataset").dataset
    before = Dataset.open(out).quarantine()
    robot_log(logs / "c.csv", ROUND_TRIP)
    assert ingest([logs], out).recordings_kept == 2
    assert Dataset.open(out).quarantine().equals(before)


def test_a_dataset_says_which_of_its_logs_have_no_checksum(logs: Path, tmp_path: Path):
    found = Dataset.open(ingest([logs], tmp_path / "dataset").dataset)
    assert {entry["facts"]["checksum"].partition(":")[0] for entry in found.recordings} == {"none"}


def test_a_log_that_goes_away_between_finding_and_reading_is_named(
    logs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    from cyclekit import intake

    read_all = intake.read_all

    def after_a_moment(*args: Any, **options: Any) -> Any:
        (logs / "b.csv").unlink()
        return read_all(*args, **options)

    monkeypatch.setattr("cyclekit.ingest.read_all", after_a_moment)
    report = ingest([logs], tmp_path / "dataset")
    assert [path for path, _ in report.not_read] == ["b.csv"]
    assert report.recordings_new == 1


def test_a_log_that_grows_while_it_is_read_is_named(logs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    from cyclekit.intake.digests import Digests

    sources = Digests.sources

    def and_the_logger_writes_on(digests: Digests, log: Any) -> Any:
        found = sources(digests, log)
        with log.path.open("ab") as file:
            file.write(b"0\r\n")
        return found

    monkeypatch.setattr(Digests, "sources", and_the_logger_writes_on)
    report = ingest([logs / "a.csv"], tmp_path / "dataset")
    assert any("changed while it was read" in text for text in report.warnings)


HOLD = """
import sys, time
from pathlib import Path
from cyclekit.atomic import staged

with staged(Path(sys.argv[1])) as folder:
    print("held", flush=True)
    time.sleep(60)
"""


@pytest.fixture
def held(tmp_path: Path) -> Iterator[subprocess.Popen[bytes]]:
    """A process that is writing at `tmp_path/dataset`."""
    words = [sys.executable, "-c", HOLD, str(tmp_path / "dataset")]
    with subprocess.Popen(words, stdout=subprocess.PIPE) as other:
        assert other.stdout is not None
        other.stdout.readline()
        yield other
        other.kill()


def test_a_second_ingest_into_one_dataset_is_refused_with_the_process_that_is_at_work(
    held: subprocess.Popen[bytes], logs: Path, tmp_path: Path
):
    with pytest.raises(BusyPlace, match=rf"dataset: another cyclekit \(process {held.pid}\) is writing there"):
        ingest([logs], tmp_path / "dataset")
    assert held.poll() is None


def test_a_lock_of_a_killed_process_does_not_block(held: subprocess.Popen[bytes], logs: Path, tmp_path: Path):
    held.kill()
    held.wait()
    assert (tmp_path / ".dataset.lock").exists()
    assert ingest([logs], tmp_path / "dataset").recordings_new == 2
    assert sorted(entry.name for entry in tmp_path.iterdir()) == ["dataset", "logs"]


def test_one_place_has_one_writer_and_the_next_has_its_turn(tmp_path: Path):
    with locked(tmp_path / "x"):
        with pytest.raises(BusyPlace), locked(tmp_path / "x", wait_s=0.0):
            pass
        with locked(tmp_path / "y"):
            pass
    with locked(tmp_path / "x"):
        pass
    assert list(tmp_path.iterdir()) == []


TAKE_TURNS = """
import sys, time
from pathlib import Path
from cyclekit.atomic import locked

inside = Path(sys.argv[1])
for _ in range(150):
    with locked(inside, wait_s=20):
        inside.touch(exist_ok=False)
        inside.unlink()
"""


def test_two_processes_are_never_inside_together(tmp_path: Path):
    words = [sys.executable, "-c", TAKE_TURNS, str(tmp_path / "inside")]
    both = [subprocess.Popen(words, stderr=subprocess.PIPE) for _ in range(2)]
    assert [(one.communicate(timeout=50)[1], one.returncode) for one in both] == [(b"", 0), (b"", 0)]


def test_a_page_that_fails_in_the_middle_leaves_the_old_one(tmp_path: Path):
    page = tmp_path / "page.html"
    write_text(page, "old")

    def fail() -> None:
        with replaced(page) as temporary:
            temporary.write_text("half", encoding="utf-8")
            raise OSError(28, "No space left on device")

    with pytest.raises(CyclekitError, match=r"page\.html: cannot be written"):
        fail()
    assert [entry.name for entry in tmp_path.iterdir()] == ["page.html"]
    assert page.read_text(encoding="utf-8") == "old"


def test_what_a_killed_process_left_of_a_page_is_swept_by_the_next(tmp_path: Path):
    (tmp_path / ".page.html.tmp-1-abc").write_text("half", encoding="utf-8")
    write_text(tmp_path / "page.html", "new")
    assert [entry.name for entry in tmp_path.iterdir()] == ["page.html"]


def test_a_place_below_a_file_cannot_be_written_and_is_named(tmp_path: Path):
    (tmp_path / "file").write_text("here", encoding="utf-8")
    for below in ("file/dataset", "file/more/dataset"):
        with pytest.raises(CyclekitError, match=r"dataset: cannot be written"), staged(tmp_path / below):
            pass
        with pytest.raises(CyclekitError, match=r"cannot be written"):
            write_text(tmp_path / below, "text")


def test_the_swap_that_fails_brings_the_old_folder_back(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    with staged(tmp_path / "d") as folder:
        write_text(folder / "a", "old")
    rename = Path.rename

    def failing(self: Path, target: Path) -> Path:
        if Path(target).name == "d" and ".new-" in self.name:
            raise OSError(5, "Input/output error")
        return rename(self, target)

    monkeypatch.setattr(Path, "rename", failing)
    with pytest.raises(CyclekitError, match="Input/output error"), staged(tmp_path / "d") as folder:
        write_text(folder / "a", "new")
    assert (tmp_path / "d" / "a").read_text(encoding="utf-8") == "old"
    assert [entry.name for entry in tmp_path.iterdir()] == ["d"]


@pytest.fixture
def mapped(tmp_path: Path) -> Path:
    """A robot log and a tracker's log in epoch time, a person's name in it, and a date in a file name."""
    folder = tmp_path / "named"
    folder.mkdir()
    t = np.arange(400) / 20
    epoch = 1_700_000_000.0
    x = [0.0 if int(s) % 4 < 2 else 0.3 for s in t]
    pl.DataFrame({"t": epoch + t, "x": x, "y": 0.0 * t}).write_csv(folder / "robot.csv")
    people = pl.DataFrame({"t": epoch + 0.5 + t, "id": ["Subject"] * 400, "x": 1 + 0.01 * t, "y": 0.0 * t})
    people.write_csv(folder / "people_2023-11-14.csv")
    (folder / "cell.toml").write_text(
        '[[sources]]\npath = "robot.csv"\nadapter = "csv"\nrole = "robot"\n'
        'map = { time = "t", x = "x", y = "y", clock = "epoch" }\n'
        '[[sources]]\npath = "people*.csv"\nadapter = "csv"\nrole = "people"\n'
        'map = { time = "t", x = "x", y = "y", person = "id", clock = "epoch" }\n',
        encoding="utf-8",
    )
    return folder


def test_a_pseudonymised_dataset_holds_neither_names_nor_the_date_and_the_same_samples(mapped: Path, tmp_path: Path):
    plain = Dataset.open(ingest([mapped], tmp_path / "plain").dataset)
    report = ingest([mapped], tmp_path / "hidden", pseudonymise=True)
    hidden = Dataset.open(report.dataset)
    away, there = hidden.samples(), plain.samples()
    numbers = [name for name, dtype in there.schema.items() if dtype.is_float()]
    for name in numbers:
        assert np.allclose(away[name].fill_null(-9), there[name].fill_null(-9), atol=1e-6), name
    for entry in hidden.recordings:
        for table in entry["tables"]:
            frame = hidden.recorded(entry["id"], table)
            assert frame["t_s"].min() == 0.0
            assert "person" not in frame.columns or set(frame["person"]) == {"person_1"}
    card = (hidden.path / "dataset.json").read_text(encoding="utf-8")
    assert "Subject" not in card
    assert "17000000" not in card
    assert any("holds a date" in text for text in report.warnings)
    assert set(plain.recorded("people_2023-11-14", "people")["person"]) == {"Subject"}


def test_native_rows_of_a_pseudonymised_execution_lie_in_its_time(mapped: Path, tmp_path: Path):
    hidden = Dataset.open(ingest([mapped], tmp_path / "hidden", pseudonymise=True).dataset)
    for row in hidden.executions.iter_rows(named=True):
        native = hidden.native_robot(row["execution"])
        assert native.height > 0
        assert native["t_s"].min() == pytest.approx(row["start_s"], abs=0.06)


def test_names_come_back_only_from_the_logs(mapped: Path, tmp_path: Path):
    out = tmp_path / "dataset"
    ingest([mapped], out, pseudonymise=True)
    assert ingest([mapped], out, pseudonymise=True).unchanged
    again = ingest([mapped], out)
    assert (again.unchanged, again.recordings_new) == (False, 2)
    assert json.loads((out / "dataset.json").read_text(encoding="utf-8"))["pseudonymised"] is False
    assert ingest([mapped], out, pseudonymise=True).recordings_new == 2


def test_a_table_that_polars_cannot_write_is_an_error_of_the_system(tmp_path: Path):
    (tmp_path / "a").mkdir()
    with pytest.raises(OSError, match="directory"):
        write_parquet(pl.DataFrame({"x": [1.0]}), tmp_path / "a")


def test_a_bag_with_checksums_says_so_and_a_csv_says_that_it_has_none(tmp_path: Path):
    bag = simulate("box-picking", tmp_path / "bag", executions=1, seed=1, options=SimulationOptions(logs="mcap"))
    ingest([bag], tmp_path / "from_bag")
    (protected,) = Dataset.open(tmp_path / "from_bag").recordings
    assert protected["facts"]["checksum"].startswith("CRC-32")
    ingest([simulate("box-picking", tmp_path / "csv", executions=1, seed=1)], tmp_path / "from_csv")
    assert all(r["facts"]["checksum"].startswith("none") for r in Dataset.open(tmp_path / "from_csv").recordings)


def _in_parts(log: Recording, cuts: list[int]) -> list[Recording]:
    (name, table), edges = next(iter(log.tables().items())), sorted({0, *cuts})
    pieces = [table[a:b] for a, b in zip(edges, [*edges[1:], table.height], strict=True) if b > a or a == 0]
    return [Recording(**{name: piece}, rows_read=piece.height) for piece in pieces]


FAULTS = [float("nan"), float("inf"), -3.0, 1e9, 7.5, 40.0, 0.8]


@settings(max_examples=150, deadline=None)
@given(
    st.lists(st.tuples(st.integers(0, 59), st.sampled_from(FAULTS)), max_size=4),
    st.lists(st.tuples(st.integers(0, 59), st.sampled_from(FAULTS)), max_size=4),
    st.lists(st.integers(12, 59), max_size=6),
    st.integers(1, 3),
)
def test_what_cannot_be_does_not_depend_on_where_a_log_was_cut_into_parts(times, places, cuts, persons: int):
    log = robot(60)
    columns = {"t_s": log.robot["t_s"].to_list(), "tcp_x_m": log.robot["tcp_x_m"].to_list()}
    for row, value in times:
        columns["t_s"][row] = value if row > 11 else columns["t_s"][row]
    for row, value in places:
        columns["tcp_x_m"][row] = value if row > 11 else columns["tcp_x_m"][row]
    tracks = pl.concat([walk(20, person=f"{number}") for number in range(persons)]).sort("t_s", maintain_order=True)
    moved = tracks["x_m"].to_list()
    for row, value in places:
        moved[row % len(moved)] = value if row > 11 else moved[row % len(moved)]
    people = Recording(people=tracks.with_columns(x_m=pl.Series(moved)))
    for one in (robot(60, **columns), people):
        at_once, name = examined(one), next(iter(one.tables()))
        in_parts = whole(examined_parts(_in_parts(one, cuts)))
        assert in_parts.tables()[name].equals(at_once.tables()[name])
        assert sorted(aside(in_parts)) == sorted(aside(at_once))
        assert in_parts.warnings == at_once.warnings
