"""Cells that log people in several ways: a PLC's trace, a tracker in some executions, fields beside a tracker."""

import shutil

import polars as pl
import pytest
from made_once import simulated

from cyclekit import estimate_cycles, evaluate_model, train_model
from cyclekit.api.train import Training, train_at
from cyclekit.config import load_cell
from cyclekit.config.sequences import TaskSequence
from cyclekit.dataset.cards import TrainingCard, texts
from cyclekit.dataset.dataset import Dataset
from cyclekit.derive.causes.cause_samples import TwoStateSignal
from cyclekit.derive.last_pass import _with_unseen
from cyclekit.errors import DatasetError
from cyclekit.ingest.ingest import ingest
from cyclekit.learning.networks.spec import ModelSpec
from cyclekit.learning.signal_inputs import as_learned_by, by_signals, left_out, mixed
from cyclekit_sim import SimulationOptions, simulate

pytestmark = pytest.mark.tests_clocks


def logs(folder, executions, seed=2, **options):
    options = {"executions_per_session": executions, **options}
    return simulate("scanner-fields", folder, executions=executions, seed=seed, options=SimulationOptions(**options))


@pytest.fixture(scope="module", params=["wide", pytest.param("long", marks=pytest.mark.slow)])
def traced(request, tmp_path_factory):
    """Return a dataset whose signals stand in a PLC's trace alone, of that form."""
    folder = tmp_path_factory.mktemp("plc")
    ingest(two_sessions(tmp_path_factory, request.param), folder / "dataset")
    return Dataset.open(folder / "dataset")


def two_sessions(factory, trace):
    return simulated(factory, "scanner-fields", 8, 2, executions_per_session=4, plc_trace=trace)


def test_signals_of_a_trace_are_found_on_the_robots_clock(traced):
    assert {(one.signal, one.occupied) for one in traced.card.operator_signals} == {
        ("warning", "1"),
        ("protective", "0"),
    }
    plc = next(one for one in traced.recordings if one.shown.endswith("plc.csv"))
    assert plc.clock.method == "event-pairs"
    assert all(abs(one.delay_s - 0.12) < 0.03 for one in traced.card.operator_signals)
    robot = pl.read_parquet(next(traced.path.rglob("robot.parquet")))
    assert "digital_in_bits" not in robot.columns or robot["digital_in_bits"].is_null().all()


@pytest.fixture(scope="module")
def partly_tracked(tmp_path_factory):
    """Return a dataset of 3 executions with a tracker and no signal, and 8 with signals and no tracker."""
    folder = tmp_path_factory.mktemp("mixed")
    for name, count, people in (("a", 3, "tracker"), ("b", 8, "signals")):
        made = logs(folder / name, count, people=people)
        shutil.copytree(made / "session_000", folder / "logs" / f"session_{name}")
    shutil.copy(folder / "a" / "cell.toml", folder / "logs" / "cell.toml")
    ingest(folder / "logs", folder / "dataset")
    return Dataset.open(folder / "dataset")


def test_signals_are_looked_for_in_the_executions_without_a_tracker(partly_tracked):
    assert {one.signal for one in partly_tracked.card.operator_signals} == {"digital-input 4", "digital-input 5"}
    said = [one for one in partly_tracked.card.warnings if one.code == "people-mixed"]
    assert [one.values for one in said] == [{"positions": 3, "signals": 8, "neither": 0}]


def test_a_model_learns_from_what_more_executions_have_and_says_what_it_leaves_out(partly_tracked):
    assert by_signals(partly_tracked)
    assert "learned from signals of people in 8 executions; 3 executions" in texts(mixed(partly_tracked))[0]
    of = partly_tracked.executions.group_by("session", maintain_order=True).agg("execution")["execution"].to_list()
    few, many = sorted(of, key=len)
    part = partly_tracked.only([*few, *many[:2]])
    assert not by_signals(part)
    assert "learned from positions of people in 3 executions; 2 executions" in texts(mixed(part))[0]
    assert mixed(partly_tracked.only(few)) == []


def test_the_other_kind_is_chosen_by_name_and_a_model_keeps_to_its_own(partly_tracked):
    learned = partly_tracked.by_people("positions")
    assert not by_signals(learned)
    assert not by_signals(learned.only(["session_a.001", "session_b.001"]))
    assert texts(mixed(learned))[0].endswith("8 executions with signals only are left out: train --people signals "
                                             "learns from those")  # fmt: skip
    of_positions, of_signals = TrainingCard(), TrainingCard(operator_signals=partly_tracked.card.operator_signals)
    assert not by_signals(as_learned_by(of_positions, partly_tracked))
    assert by_signals(as_learned_by(of_signals, partly_tracked))
    assert "operators of 3 executions with positions of people" in left_out(of_positions, partly_tracked)[0]
    assert "3 executions with positions only are left out" in left_out(of_signals, partly_tracked)[0]


def test_a_kind_that_no_log_holds_is_refused(traced):
    with pytest.raises(DatasetError, match="no log holds positions of people") as refused:
        traced.by_people("positions")
    assert "--people" in refused.value.cure
    assert traced.by_people("signals") is not traced
    assert left_out(TrainingCard(), traced) == []


@pytest.mark.slow  # trains a model
def test_a_model_of_the_rarer_kind_is_learned_judged_and_asked(partly_tracked, tmp_path):
    card = train_at(Training(str(partly_tracked.path), ModelSpec.of(epochs=2), str(tmp_path / "m"), people="positions"))
    assert not card.operator_signals
    assert len(card.held_out) == 1
    assert "learned from positions of people in 3 executions" in texts(card.warnings)[0]
    assert evaluate_model(tmp_path / "m", partly_tracked, boosting=False).metrics.rows > 0
    order = TaskSequence("logged", partly_tracked.card.executions[0].places)
    (found,) = estimate_cycles(tmp_path / "m", partly_tracked, order, other_cell=True)
    assert found.executions == 3
    assert any("3 executions with positions of people" in text for text in found.warnings)


def test_somebody_in_a_field_whom_the_tracker_does_not_see_is_there_and_hidden(tmp_path):
    made = logs(tmp_path / "logs", 3, people="both")
    log = made / "session_000" / "operator.csv"
    head, rows = log.read_text().splitlines()[:7], log.read_text().splitlines()[7:]
    blind = [",".join(row.split(",")[:2]) + "," * 7 for row in rows]
    log.write_text("\r\n".join([*head, *blind]) + "\r\n")
    with (made / "cell.toml").open("a") as cell:
        cell.write('\n[[operator_signals]]\nname = "warning field"\nsignal = "digital-input 4"\noccupied = "TRUE"\n')
    assert load_cell(made / "cell.toml").operator_signals[0].occupied == "TRUE"
    ingest(made, tmp_path / "dataset")
    dataset = Dataset.open(tmp_path / "dataset")
    samples = dataset.samples().drop_nulls("human_signals")
    gaps = {on: set(samples.filter(pl.col("human_signals") == on)["human_gap"]) for on in (0, 1)}
    assert gaps == {0: {"absent"}, 1: {"occluded"}}
    said = next(one for one in dataset.card.warnings if one.code == "operator-unseen")
    assert said.values["samples"] == (samples["human_signals"] == 1).sum()


def test_a_tracker_without_a_robot_log_is_told_what_is_missing(tmp_path):
    made = logs(tmp_path / "logs", 1, people="tracker")
    (made / "session_000" / "robot.csv").unlink()
    report = ingest(made, tmp_path / "dataset")
    assert any(text.startswith("there is no robot log") for text in report.warnings)
    with pytest.raises(DatasetError, match="no log of the robot was ingested") as refused:
        train_model(tmp_path / "dataset")
    assert "log of the robot's controller beside the tracker's" in refused.value.cure


def test_an_unknown_signal_hides_nobody():
    samples = pl.DataFrame({"t_s": [0.0, 1.0], "human_gap": ["absent", "absent"]})
    same, hidden = _with_unseen(samples, {}, ["field"])
    assert (same["human_gap"].to_list(), hidden) == (["absent", "absent"], 0)
    on = TwoStateSignal(pl.Series([0.5]).to_numpy(), pl.Series([True]).to_numpy())
    changed, hidden = _with_unseen(samples, {"field": on}, ["field"])
    assert (changed["human_gap"].to_list(), hidden) == (["absent", "occluded"], 1)


@pytest.mark.parametrize("apart_s", [pytest.param(2_000, marks=pytest.mark.slow), 400_000])  # a shift, or days
def test_robot_logs_of_one_folder_share_a_trace_each_with_a_clock_of_its_own(tmp_path, tmp_path_factory, apart_s):
    made, shared = two_sessions(tmp_path_factory, "wide"), tmp_path / "logs"
    shared.mkdir()
    rows = []
    for number, later_s in enumerate((0, apart_s)):
        shutil.copy(made / f"session_00{number}" / "robot.csv", shared / f"shift_{number}.csv")
        lines = (made / f"session_00{number}" / "plc.csv").read_text().splitlines()[1:]
        times = ((float(line.split(";")[0].replace(",", ".")) + 1e3 * later_s, line) for line in lines)
        rows += [f"{t_ms:.1f}".replace(".", ",") + line[line.index(";") :] for t_ms, line in times]
    header = (made / "session_000" / "plc.csv").read_text().splitlines()[0]
    (shared / "plc.csv").write_text("\n".join([header, *rows]) + "\n")
    cell = (
        (made / "cell.toml").read_text().replace("session_*/plc.csv", "plc.csv").replace("session_*/robot", "shift_*")
    )
    (shared / "cell.toml").write_text(cell)
    ingest(shared, tmp_path / "dataset", pseudonymise=True)
    ingest(shared, tmp_path / "dataset")
    dataset = Dataset.open(tmp_path / "dataset")
    traces = [one for one in dataset.recordings if one.tables == ("events",)]
    assert sorted(round(one.clock.offset_s) for one in traces) == [-41 - apart_s, -41]
    assert {one.session for one in traces} == {one.session for one in dataset.recordings}
    assert len({one.id for one in traces}) == len({one.sources[0].path for one in traces}) + 1 == 2
    assert dataset.samples()["human_signals"].null_count() == 0
    assert {one.signal for one in dataset.card.operator_signals} == {"warning", "protective"}
    assert max(one.explained for one in dataset.card.operator_signals) > 0.9


@pytest.mark.slow  # trains a model
def test_the_whole_way_with_a_trace_beside_a_robot_log_without_inputs(traced, tmp_path):
    card = train_at(Training(str(traced.path), ModelSpec.of(epochs=3), str(tmp_path / "model")))
    assert [one.name for one in card.operator_signals] == [one.name for one in traced.card.operator_signals]
    order = traced.card.executions[0].places
    (found,) = estimate_cycles(tmp_path / "model", traced.path, TaskSequence("logged", order))
    logged = traced.executions.filter("complete")["duration_s"].mean()
    assert found.expected_s == pytest.approx(logged, rel=0.15)
