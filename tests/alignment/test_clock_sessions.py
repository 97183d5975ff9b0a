"""Clocks of whole sessions: what the cell file asks for is found in the logs, or refused; measured against the truth.

The cell is box picking, with a tracker whose clock is 0.35 s behind what anybody wrote down and runs 50 ppm fast, and
which loses frames.
"""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest

from cyclekit.config import Cell, Source, Sync, load_cell
from cyclekit.dataset.cards import ClockCard, RecordingCard, plain
from cyclekit.dataset.dataset import Dataset
from cyclekit.errors import ConfigError, UnknownName
from cyclekit.ingest.ingest import ingest
from cyclekit_sim import SimulationOptions, simulate

pytestmark = pytest.mark.tests_clocks

OFFSET_S, DRIFT, LEAD_S, ROBOT_START_S = 0.35, 50e-6, 6.0, 152.512
EXECUTIONS = 7


def tracker_time(session_s: np.ndarray) -> np.ndarray:
    """What the tracker's clock shows, as the simulator has it."""
    return (session_s + LEAD_S) * (1 + DRIFT) - OFFSET_S


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Long enough for clocks to be placed as well as they can be."""
    return logs_of(tmp_path_factory.mktemp("clocks") / "logs", EXECUTIONS)


@pytest.fixture(scope="module")
def few(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Long enough to say what is done with a clock."""
    return logs_of(tmp_path_factory.mktemp("few") / "logs", 2)


def logs_of(folder: Path, executions: int) -> Path:
    """The cell, with two logs more: the gripper as the tracker's input saw it, and the flange as the tracker saw it."""
    options = SimulationOptions(clock_offset_s=OFFSET_S, clock_drift=DRIFT, dropout=0.05, delta_m=0.005)
    simulate("box-picking", folder, executions=executions, seed=3, options=options)
    session = folder / "session_000"
    columns = ["timestamp", "actual_digital_output_bits", *(f"actual_TCP_pose_{i}" for i in range(3))]
    robot = pl.read_csv(session / "robot.csv", separator=" ", columns=columns).select(columns).to_numpy()
    session_s = robot[:, 0] - ROBOT_START_S
    write_gripper(session / "gripper.csv", session_s, robot[:, 1].astype(int))
    write_flange(session / "flange.csv", session_s, robot[:, 2:])
    return folder


def write_gripper(path: Path, session_s: np.ndarray, bits: np.ndarray) -> None:
    """Rises of the output with 3 ms of jitter; one in ten is missing, and there are ten that nobody knows."""
    rng = np.random.default_rng(1)
    rises = session_s[1:][np.diff(bits & 1) == 1] - 0.004  # the output changed within the control cycle before
    rises = rises[rng.random(len(rises)) > 0.1]
    seen = tracker_time(np.concatenate([rises, rng.uniform(0, session_s[-1], 10)]))
    seen = np.sort(seen + rng.normal(0.0, 0.003, len(seen)))
    rows = [f"{t:.5f},sync_in,1\n{t + 0.05:.5f},sync_in,0" for t in seen.tolist()]
    path.write_text("time,signal,value\n" + "\n".join(rows) + "\n", encoding="utf-8")


def write_flange(path: Path, session_s: np.ndarray, tcp_m: np.ndarray) -> None:
    """A rigid body on the flange: 50 Hz, 1 mm of noise, frames lost, and the operator beside it."""
    rng = np.random.default_rng(2)
    frames = np.arange(int(session_s[-1] * 50)) / 50
    at = (frames + OFFSET_S) / (1 + DRIFT) - LEAD_S
    known = (at > 0) & (np.repeat(rng.random(len(frames) // 10 + 1), 10)[: len(frames)] > 0.05)
    xyz = np.column_stack([np.interp(at, session_s, tcp_m[:, k]) for k in range(3)])
    xyz += rng.normal(0.0, 0.001, xyz.shape)
    head = "Format Version,1.23,Take Name,t,Capture Frame Rate,50.0,Export Frame Rate,50.0"
    head += f",Total Exported Frames,{len(frames)},Rotation Type,Quaternion,Length Units,Meters,Coordinate Space,Global"
    lines = [head, "", ",Type" + ",Rigid Body" * 7, ",Name" + ",Flange" * 7, ",ID" + ',"6D79"' * 7]
    lines += ["," + ",Rotation" * 4 + ",Position" * 3, "Frame,Time (Seconds),X,Y,Z,W,X,Y,Z"]
    for number, (seen, (x, y, z)) in enumerate(zip(known.tolist(), xyz.tolist(), strict=True)):
        cells = f"0.0,0.0,0.0,1.0,{x:.5f},{z:.5f},{-y:.5f}" if seen else ",,,,,,"
        lines.append(f"{number},{number / 50:.6f},{cells}")
    path.write_text("\r\n".join(lines) + "\r\n", encoding="utf-8", newline="")


def cell_with(logs: Path, operator: dict[str, Any], *others: Source, only: bool = True) -> Cell:
    """The simulated cell, with other words about the operator's clock; buttons as the operator."""
    cell = load_cell(logs / "cell.toml")
    robot, people, events = cell.sources
    silent = {"clock_offset_s": None, "clock_rate": 1.0}
    tracker = replace(people, **(silent | operator))
    buttons = replace(events, **(silent | {"same_clock_as": "session_*/operator.csv"}))
    names = {"gripper.csv", "flange.csv"} - {Path(other.path).name for other in others}
    ignore = (*cell.ignore, *(f"session_*/{name}" for name in names)) if only else cell.ignore
    return replace(cell, sources=(robot, tracker, buttons, *others), ignore=ignore)


GRIPPER = Source(
    "session_*/gripper.csv",
    adapter="csv",
    role="events",
    sync=Sync("digital-output 0", "sync_in"),
    map={"delimiter": ",", "time": "time", "time_unit": "s", "signal": "signal", "value": "value"},
)
FLANGE = Source("session_*/flange.csv", role="people", sees="tcp")


def ingested(logs: Path, out: Path, cell: Cell, **options: Any) -> tuple[Dataset, RecordingCard]:
    """The dataset, and the operator's recording in it."""
    ingest([logs], out, cell=cell, **options)
    dataset = Dataset.open(out)
    hidden = options.get("pseudonymise", False)  # then only its table tells it
    operator = (r for r in dataset.recordings if "people" in r.tables) if hidden else (
        r for r in dataset.recordings if r.shown.endswith("operator.csv")
    )  # fmt: skip
    return dataset, next(operator)


def worst_s(clock: ClockCard, length_s: float) -> float:
    """How far the clock is off, anywhere in the run."""
    session_s = np.linspace(0.0, length_s, 50)
    return float(np.abs(clock.rate * tracker_time(session_s) + clock.offset_s - session_s).max())


def length_s(dataset: Dataset) -> float:
    return float(max(entry.end_s for entry in dataset.card.executions))


@pytest.fixture(scope="module")
def by_gripper(logs: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Dataset, RecordingCard]:
    """The tracker's clock placed by the gripper."""
    cell = cell_with(logs, {"same_clock_as": "session_*/gripper.csv"}, GRIPPER)
    return ingested(logs, tmp_path_factory.mktemp("gripper") / "d", cell)


def test_events_of_the_gripper_place_the_tracker_within_two_milliseconds(by_gripper: tuple[Dataset, RecordingCard]):
    dataset, operator = by_gripper
    clock = operator.clock
    assert clock.method == "event-pairs"
    assert clock.same_as.endswith("gripper")
    assert worst_s(clock, length_s(dataset)) < 0.002
    assert clock.rate == pytest.approx(1 / (1 + DRIFT), abs=4e-6)
    assert clock.residual_s == pytest.approx(0.0037, rel=0.25)  # 3 ms of jitter, and where in the cycle it rose
    assert clock.events > 60
    assert clock.events_rejected >= 5
    assert clock.second_best < 0.5
    assert not any("clock" in text for text in operator.said)


def test_the_flange_seen_by_the_tracker_places_it_within_half_a_millisecond_and_is_no_person(
    logs: Path, tmp_path: Path
):
    cell = cell_with(logs, {"same_clock_as": "session_*/flange.csv"}, FLANGE)
    dataset, operator = ingested(logs, tmp_path / "d", cell)
    clock = operator.clock
    assert clock.method == "motion"
    assert worst_s(clock, length_s(dataset)) < 0.0005
    assert clock.rate == pytest.approx(1 / (1 + DRIFT), abs=5e-6)
    assert clock.correlation > 0.9
    assert 0.3 < clock.second_best < 0.9  # the cell does one thing after the other, in ever other orders
    assert clock.residual_s < 0.003
    samples = dataset.samples()
    apart = (
        samples.select("robot_x_m", "robot_y_m", "robot_z_m").to_numpy()
        - samples.select("human_x_m", "human_y_m", "human_z_m").to_numpy()
    )
    assert np.nanmin(np.linalg.norm(apart, axis=1)) > 0.1  # the body on the flange would be at 0


def test_a_body_on_the_flange_that_the_log_does_not_hold_is_refused(few: Path, tmp_path: Path):
    unknown = replace(FLANGE, sees_as="Flang")
    with pytest.raises(ConfigError, match="the nearest is 'Flange'"):
        ingested(few, tmp_path / "d", cell_with(few, {"same_clock_as": FLANGE.path}, unknown))


def test_a_person_is_no_body_on_the_flange(few: Path, tmp_path: Path):
    with pytest.raises(ConfigError, match="never agree"):
        ingested(few, tmp_path / "d", cell_with(few, {"sees": "tcp"}))


def test_pairs_of_the_cell_file_place_the_tracker(few: Path, tmp_path: Path):
    session_s = np.array([10.0, 100.0, 200.0])
    pairs = tuple(zip(tracker_time(session_s).tolist(), (session_s + ROBOT_START_S).tolist(), strict=True))
    dataset, operator = ingested(few, tmp_path / "d", cell_with(few, {"sync_events": pairs}))
    assert operator.clock.method == "event-pairs"
    assert operator.clock.events == 3
    assert worst_s(operator.clock, length_s(dataset)) < 1e-6


def test_a_robot_that_was_switched_off_and_on_is_aligned_in_both_parts(few: Path, tmp_path: Path):
    logs = shutil.copytree(few, tmp_path / "logs")
    (robot,) = logs.rglob("robot.csv")
    log = pl.read_csv(robot, separator=" ")
    half_s = log["timestamp"][log.height // 2] - ROBOT_START_S
    again = pl.int_range(pl.len()) >= pl.len() // 2
    since_s = log["timestamp"] - log["timestamp"][log.height // 2] + 20.0
    log.with_columns(timestamp=pl.when(again).then(since_s).otherwise("timestamp")).write_csv(robot, separator=" ")
    dataset, _ = ingested(logs, tmp_path / "d", cell_with(few, {"same_clock_as": GRIPPER.path}, GRIPPER))
    assert [one.session for one in dataset.recordings if "robot" in one.tables] == ["session_000", "session_000-2"]
    assert dataset.card.warnings[0].code == "log-divided"
    people = {one.session: one.clock for one in dataset.recordings if "people" in one.tables}
    assert worst_s(people["session_000"], half_s) < 0.01
    later = people["session_000-2"]
    of_whole = ClockCard(kind=later.kind, method="own", offset_s=later.offset_s + half_s, rate=later.rate)
    assert worst_s(of_whole, length_s(dataset)) < 0.01
    assert not [one for clock in people.values() for one in clock.warnings if one.code != "clock-second-best"]


def test_a_wrong_signal_is_refused_with_those_that_are_there(few: Path, tmp_path: Path):
    wrong = replace(GRIPPER, sync=Sync("digital-output 0", "sync_out"))
    with pytest.raises(ConfigError) as caught:
        ingested(few, tmp_path / "d", cell_with(few, {"same_clock_as": GRIPPER.path}, wrong))
    assert caught.value.nearest == "sync_in"
    assert "gripper.csv" in str(caught.value)
    silent = replace(GRIPPER, sync=Sync("digital-output 7", "sync_in"))
    with pytest.raises(ConfigError, match="0 in the robot's"):
        ingested(few, tmp_path / "d", cell_with(few, {"same_clock_as": GRIPPER.path}, silent))
    with pytest.raises(ConfigError, match="holds none"):
        ingested(few, tmp_path / "d", cell_with(few, {"sync": Sync("digital-output 0", "sync_in")}))
    with pytest.raises(UnknownName, match="same_clock_as"):
        ingested(few, tmp_path / "d", cell_with(few, {"same_clock_as": "nowhere.csv"}))


def test_two_logs_that_borrow_each_other_s_clock_are_refused(few: Path, tmp_path: Path):
    with pytest.raises(ConfigError, match="takes its clock"):
        ingested(few, tmp_path / "d", cell_with(few, {"same_clock_as": "session_*/events.csv"}))


def test_a_tracker_of_unknown_clock_is_aligned_by_the_logs(logs: Path, tmp_path: Path):
    dataset, operator = ingested(logs, tmp_path / "d", cell_with(logs, {}))
    clock = operator.clock
    assert clock.method == "logs"
    assert worst_s(clock, length_s(dataset)) < 0.1  # this safety function has no delay to hide
    assert any("reaction delay" in text for text in operator.said)
    buttons = next(one for one in dataset.recordings if one.shown.endswith("events.csv"))
    assert buttons.clock.same_as == operator.id
    assert buttons.clock.offset_s == clock.offset_s


def test_a_tracker_of_unknown_clock_is_aligned_with_each_part_of_a_restarted_robot(logs: Path, tmp_path: Path):
    folder = shutil.copytree(logs, tmp_path / "logs")
    (robot,) = folder.rglob("robot.csv")
    log = pl.read_csv(robot, separator=" ")
    half_s = log["timestamp"][log.height // 2] - ROBOT_START_S
    again = pl.int_range(pl.len()) >= pl.len() // 2
    since_s = log["timestamp"] - log["timestamp"][log.height // 2] + 20.0
    log.with_columns(timestamp=pl.when(again).then(since_s).otherwise("timestamp")).write_csv(robot, separator=" ")
    dataset, _ = ingested(folder, tmp_path / "d", cell_with(logs, {}), align_clocks="logs")
    first, later = (one.clock for one in dataset.recordings if "people" in one.tables)
    assert (first.method, later.method) == ("logs", "logs")
    assert worst_s(first, half_s) < 0.2
    of_whole = ClockCard(kind=later.kind, method="own", offset_s=later.offset_s + half_s, rate=later.rate)
    assert worst_s(of_whole, 2 * half_s) < 0.2
    unasked, _ = ingested(folder, tmp_path / "unasked", cell_with(logs, {}))  # six minutes leave doubt
    kept = [one.clock for one in unasked.recordings if "people" in one.tables][-1]
    assert kept.method == "logs" or "nobody is seen in it" in kept.warnings[0].text


def test_a_stated_clock_that_is_wrong_is_named_with_its_line_and_aligned_on_request(logs: Path, tmp_path: Path):
    cell = cell_with(logs, {"clock_offset_s": 110.0})
    operator = ingested(logs, tmp_path / "d", cell)[1]
    assert operator.clock.method == "cell-file"
    (said,) = [text for text in operator.said if "its clock is wrong" in text]
    line = float(said.partition("give clock_offset_s = ")[2].partition(",")[0])
    assert line == pytest.approx(ROBOT_START_S - LEAD_S + OFFSET_S, abs=0.1)
    again, mended = ingested(logs, tmp_path / "again", replace(cell, align_clocks="logs"))
    assert mended.clock.method == "logs"
    assert worst_s(mended.clock, length_s(again)) < 0.1


def test_a_stated_clock_that_is_right_is_confirmed_and_kept(logs: Path, tmp_path: Path):
    cell = cell_with(logs, {"clock_offset_s": ROBOT_START_S - LEAD_S + OFFSET_S})
    operator = ingested(logs, tmp_path / "d", replace(cell, align_clocks="logs"))[1]
    assert operator.clock.method == "cell-file"
    assert operator.clock.test is not None
    assert operator.clock.test.certain
    assert not [text for text in operator.said if "clock" in text]


def without_slow_downs(logs: Path, folder: Path) -> Path:
    """The logs of a robot that nobody slows."""
    shutil.copytree(logs, folder)
    (robot,) = folder.rglob("robot.csv")
    pl.read_csv(robot, separator=" ").with_columns(speed_scaling=pl.lit(1.0)).write_csv(robot, separator=" ")
    return folder


def test_logs_that_tell_no_lag_leave_a_common_start_and_say_so_if_asked(few: Path, tmp_path: Path):
    logs = without_slow_downs(few, tmp_path / "logs")
    plain = ingested(logs, tmp_path / "d", cell_with(few, {}))[1]
    assert plain.clock.method == "assumed-common-start"
    assert any("a common start is assumed" in text for text in plain.said)
    asked = ingested(logs, tmp_path / "asked", cell_with(few, {}), align_clocks="logs")[1]
    assert asked.clock.method == "assumed-common-start"
    assert any("not aligned by the logs" in text for text in asked.said)


def test_a_lag_that_is_not_certain_is_used_on_request_alone_and_says_so(few: Path, tmp_path: Path):
    logs = tmp_path / "logs"
    shutil.copytree(few, logs)
    take = next(logs.rglob("operator.csv"))
    lines = take.read_text(encoding="utf-8").splitlines()
    take.write_text("\r\n".join(lines[: 7 + 90 * 60]) + "\r\n", encoding="utf-8", newline="")  # a minute and a half
    cell = cell_with(few, {})
    assert ingested(logs, tmp_path / "d", cell)[1].clock.method == "assumed-common-start"
    operator = ingested(logs, tmp_path / "asked", cell, align_clocks="logs")[1]
    assert operator.clock.method == "logs"
    assert any("NOT certain" in text for text in operator.said)


def test_clocks_that_the_logs_do_not_contradict_are_kept(few: Path, tmp_path: Path):
    cell = cell_with(few, {"clock_offset_s": 146.862})
    assert ingested(few, tmp_path / "d", cell, align_clocks="logs")[1].clock.method == "cell-file"


@pytest.mark.parametrize(("late_s", "method"), [(5.0, "logs"), pytest.param(0.0, "epoch", marks=pytest.mark.slow)])
def test_alignment_on_request_corrects_a_computer_whose_clock_is_off(
    logs: Path, tmp_path: Path, late_s: float, method: str
):
    """Both logs have time since 1970, but the tracker's computer is not synchronised."""
    folder, since_s = tmp_path / "logs", 1_700_000_000.0
    shutil.copytree(logs, folder, ignore=shutil.ignore_patterns("flange.csv", "gripper.csv", "events.csv"))
    session = folder / "session_000"
    robot = pl.read_csv(session / "robot.csv", separator=" ")
    robot.with_columns(pl.col("timestamp") + since_s).write_csv(session / "robot.csv", separator=" ")
    lines = (session / "operator.csv").read_text(encoding="utf-8").splitlines()[7:]
    frames = np.array([[float(cell or "nan") for cell in line.split(",")] for line in lines])
    at = (frames[:, 1] + OFFSET_S) / (1 + DRIFT) - LEAD_S + ROBOT_START_S + since_s + late_s
    x, up, z = frames[:, -3:].T
    rows = pl.DataFrame({"time": at, "x": x, "y": -z, "z": up}).drop_nans()
    rows.write_csv(session / "people.csv", float_precision=4)
    (session / "operator.csv").unlink()
    cell = cell_with(logs, {}, only=False)
    columns = {name: name for name in ("time", "x", "y", "z")}
    layout = {"delimiter": ",", "clock": "epoch", "time_unit": "s", "length_unit": "m", **columns}
    tracker = Source("session_*/people.csv", adapter="csv", role="people", frame=cell.sources[1].frame, map=layout)
    cell = replace(cell, sources=(cell.sources[0], tracker))
    ingest([folder], tmp_path / "d", cell=cell, align_clocks="logs")
    dataset = Dataset.open(tmp_path / "d")
    clocks = {name: one.clock for one in dataset.recordings for name in one.tables}
    assert clocks["people"].method == method
    assert clocks["people"].offset_s + late_s + since_s + ROBOT_START_S == pytest.approx(0.0, abs=0.1)


def test_start_texts_place_a_log_to_a_second_or_so(few: Path, tmp_path: Path):
    cell = cell_with(few, {"start": "2026-03-02T14:03:05+01:00"})
    with pytest.raises(ConfigError, match="no time of day"):
        ingested(few, tmp_path / "d", cell)
    robot = replace(cell.sources[0], start="2026-03-02T13:03:11+00:00")
    _, operator = ingested(few, tmp_path / "d", replace(cell, sources=(robot, *cell.sources[1:])))
    assert operator.clock.method == "start-text"
    assert operator.clock.offset_s == pytest.approx(-6.0)
    assert any("accurate to about a second" in text for text in operator.said)


def test_a_clock_found_once_is_kept_with_what_was_read_and_its_warnings_are_not_doubled(few: Path, tmp_path: Path):
    cell = cell_with(few, {})
    ingested(few, tmp_path / "d", cell, align_clocks="logs")
    _, operator = ingested(few, tmp_path / "d", replace(cell, bridge_s=0.4), align_clocks="logs")
    assert len([text for text in operator.said if "aligned by the logs" in text]) == 1


def test_pseudonymised_clocks_tell_no_time_and_still_find_the_flange_that_is_named(few: Path, tmp_path: Path):
    known = replace(FLANGE, sees_as="Flange")
    cell = cell_with(few, {"same_clock_as": known.path, "start": "2026-03-02T14:03:05+01:00"}, known)
    dataset, operator = ingested(few, tmp_path / "d", cell, pseudonymise=True)
    assert operator.clock.method == "motion"
    assert "2026-03-02" not in json.dumps(plain(dataset.card))


def test_the_clocks_of_a_dataset_are_told_by_inspect_and_by_the_report(by_gripper: tuple[Dataset, RecordingCard]):
    from cyclekit.cli.facts import page
    from cyclekit.inspect.describe import describe
    from cyclekit.report.provenance import provenance

    dataset, operator = by_gripper
    shown = page(describe(dataset.path))
    assert "event-pairs" in shown
    assert f"{1000 * operator.clock.residual_s:.1f}" in shown
    assert f"{operator.clock.events}" in shown
    assert "occluded" in shown
    assert max(map(len, shown.splitlines()[1:])) <= 80  # the first holds the path
    told = [source.clock for source in provenance(dataset, {}).sources if "event-pairs" in source.clock]
    assert told
    assert all("residual" in text and "rate 0.9999" in text and "events" in text for text in told)


def test_a_gap_of_the_track_is_counted_by_its_reason(logs: Path, tmp_path: Path):
    session = tmp_path / "logs" / "session_000"
    shutil.copytree(logs / "session_000", session)
    lines = (session / "operator.csv").read_text(encoding="utf-8").splitlines()
    rows = [line.split(",") for line in lines[7:]]
    times = np.array([float(row[1]) for row in rows])
    away, hidden, over = (times > 200) & (times < 230), (times > 300) & (times < 303), times > 500
    kept = [
        ",".join([*row[:2], *[""] * 7] if gone else row)
        for row, gone, after in zip(rows, (away | hidden).tolist(), over.tolist(), strict=True)
        if not after
    ]
    (session / "operator.csv").write_text("\r\n".join([*lines[:7], *kept]) + "\r\n", encoding="utf-8", newline="")
    dataset, operator = ingested(tmp_path / "logs", tmp_path / "d", cell_with(logs, {"clock_offset_s": 146.862}))
    counts, samples = operator.operator, dataset.samples()
    t = samples["t_s"].to_numpy() + 6.0 - OFFSET_S
    assert counts.absent == pytest.approx(((t > 200) & (t < 230)).sum(), abs=8)
    assert counts.outside == pytest.approx((t > 500).sum(), abs=3)
    assert ((t > 300) & (t < 303)).sum() - 3 <= counts.occluded  # and the frames that the tracker lost anyway
    assert counts.occluded + counts.absent + counts.outside == samples["human_x_m"].null_count()
