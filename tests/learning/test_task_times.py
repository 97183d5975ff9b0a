"""Task times learned from task lists: rates beside other tasks, what each start waits for, plans rolled out."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from threadpoolctl import threadpool_info, threadpool_limits

from cyclekit import (
    TaskSequence,
    estimate_cycles,
    evaluate_task_times,
    plan_order,
    train_model,
    train_task_times,
    what_if,
    write_report,
)
from cyclekit.config.sequences import PlannedTask
from cyclekit.dataset.cards.task_model import TaskModelCard
from cyclekit.dataset.dataset import Dataset
from cyclekit.errors import ConfigError, DatasetError, EstimateError, ModelError
from cyclekit.estimate.gantt import blocks_of
from cyclekit.estimate.plan.jobs import Jobs
from cyclekit.estimate.plan.task_orders import JobTask, TaskJobs, TaskOrderPlan
from cyclekit.estimate.task_times import estimate_plans
from cyclekit.estimate.whatif.change import Change
from cyclekit.ingest.ingest import ingest
from cyclekit.learning.task_times.learn import learn_runs, learn_task_times
from cyclekit.learning.task_times.rates import fit_rates
from cyclekit.learning.task_times.roll import roll_plan
from cyclekit.learning.task_times.runs import DoneTask, Run, logged_runs
from cyclekit.learning.task_times.saved import TaskTimesModel, load_task_times
from cyclekit.learning.task_times.starts import learn_starts
from cyclekit_sim.task_lists import ListOptions, Order, fresh_durations, random_order, simulate_task_lists


def listed(folder: Path, seed: int, options: ListOptions) -> Dataset:
    simulate_task_lists(folder / "logs", executions=40, seed=seed, options=options)
    ingest([folder / "logs" / "tasks.csv"], folder / "dataset")
    return Dataset.open(folder / "dataset")


def learned(folder: Path, seed: int, options: ListOptions) -> TaskTimesModel:
    listed(folder, seed, options)
    return train_task_times(folder / "dataset", out=folder / "model")


@pytest.fixture(scope="module")
def coupled(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, TaskTimesModel]:
    folder = tmp_path_factory.mktemp("coupled")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("cyclekit.learning.task_times.learn.FOLDS", 2)
        return folder, learned(folder, 1, ListOptions())


def plan_of(order: Order, name: str = "plan") -> TaskSequence:
    return TaskSequence.of_plan(name, [PlannedTask(agent, task) for agent, tasks in order.items() for task in tasks])


def test_who_waits_for_whom_is_found_and_nothing_else(coupled) -> None:
    needs = {(task.task, need.task, need.back) for task in coupled[1].card.tasks for need in task.needs}
    assert needs == {("mount", "bring", 0), ("weld", "mount", 0)}
    assert not any(task.planned for task in coupled[1].card.tasks)


@pytest.mark.slow
def test_nothing_is_found_where_nobody_waits(tmp_path) -> None:
    card = learned(tmp_path, 3, ListOptions(coupled=False)).card
    assert not any(task.needs for task in card.tasks)


def test_a_task_that_another_slows_has_a_lower_rate_beside_it(coupled) -> None:
    (weld,) = (task for task in coupled[1].card.tasks if task.task == "weld")
    assert weld.rates["worker: inspect"] / weld.rates["worker: pack"] == pytest.approx(0.6, abs=0.08)


def test_a_plan_never_logged_takes_what_fresh_executions_take(coupled) -> None:
    folder, _ = coupled
    rng = np.random.default_rng(99)
    orders = [random_order(rng) for _ in range(3)]
    answers = estimate_cycles(
        folder / "model", folder / "dataset", [plan_of(order, str(n)) for n, order in enumerate(orders)]
    )
    for answer in answers:
        true_s = np.array(fresh_durations(orders[int(answer.name)], cycles=200, seed=int(answer.name)))
        assert answer.expected_s == pytest.approx(true_s.mean(), rel=0.02)
        assert answer.expected_low_s < true_s.mean() < answer.expected_high_s
        inside = (true_s >= answer.quantiles_s[0.05]) & (true_s <= answer.quantiles_s[0.95])
        assert 0.8 <= inside.mean() <= 1.0
        split = answer.nominal_s, answer.safety_loss_s, answer.wait_s, answer.idle_s
        assert sum(split) == pytest.approx(answer.expected_s)
        assert min(split) >= 0.0 or min(split) == answer.safety_loss_s


def test_the_share_of_a_plan_within_its_printed_quantile_is_the_level(coupled) -> None:
    folder, _ = coupled
    asked = [plan_of(random_order(np.random.default_rng(99)))]
    (first,) = estimate_cycles(folder / "model", folder / "dataset", asked)
    for level, at_s in first.quantiles_s.items():
        (found,) = estimate_cycles(folder / "model", folder / "dataset", asked, takt_s=at_s + 1e-6)
        assert found.takt_probability[0] == pytest.approx(level, abs=0.005)


def test_waits_appear_with_what_ended_them(coupled) -> None:
    folder, _ = coupled
    order = {"robot": ["bring", "weld"], "operator": ["inspect", "mount", "pack"]}
    (answer,) = estimate_cycles(folder / "model", folder / "dataset", plan_of(order))
    (weld,) = (task for task in answer.plan if task.task == "weld")
    (mount,) = (task for task in answer.plan if task.task == "mount")
    assert weld.wait_s > 4.0
    assert weld.start_s > mount.end_s
    assert max(weld.decided, key=lambda name: weld.decided[name]) == "operator: mount"
    assert json.loads(json.dumps(answer.to_dict()))["plan"][1]["wait_s"] == pytest.approx(weld.wait_s)


def test_the_time_chart_shows_waits_with_an_arrow_from_what_ended_them(coupled, tmp_path) -> None:
    folder, _ = coupled
    order = {"robot": ["bring", "weld"], "operator": ["inspect", "mount", "pack"]}
    file = tmp_path / "chart.svg"
    found = estimate_cycles(folder / "model", folder / "dataset", plan_of(order), gantt=file)
    assert "written by cyclekit" in file.read_text(encoding="utf-8")
    (block,) = blocks_of(found)
    assert block.lanes == ("robot", "operator")
    named = {label.texts[0].partition(" ")[2]: label for label in block.labels}
    assert set(named) == {"bring", "weld", "inspect", "mount", "pack"}
    (wait,) = (bar for bar in block.bars if bar.waits and bar.lane == 0)
    assert (wait.start_s, wait.end_s) == pytest.approx((named["bring"].end_s, named["weld"].start_s))
    (arrow,) = (arrow for arrow in block.arrows if arrow.to_lane == 0)
    assert (arrow.from_s, arrow.to_s) == pytest.approx((named["mount"].end_s, named["weld"].start_s))


def test_an_earliest_start_and_a_told_precedence_are_kept(coupled) -> None:
    model = coupled[1].card
    plan = [
        PlannedTask("robot", "polish", not_before_s=30.0),
        PlannedTask("worker", "pack", after=("polish",)),
    ]
    rolled = roll_plan(model, plan, cycles=20)
    assert (rolled.start_s[:, 0] >= 30.0).all()
    assert (rolled.start_s[:, 1] >= rolled.end_s[:, 0]).all()


def test_tasks_that_wait_for_each_other_are_refused(coupled) -> None:
    folder, _ = coupled
    stuck = TaskSequence.of_plan(
        "stuck",
        [PlannedTask("robot", "weld"), PlannedTask("robot", "bring"), PlannedTask("operator", "mount")],
    )
    with pytest.raises(EstimateError, match="robot: weld never starts"):
        estimate_cycles(folder / "model", folder / "dataset", stuck)


def test_what_was_never_logged_is_named_with_what_was(coupled) -> None:
    folder, _ = coupled
    unknown = TaskSequence.of_plan("x", [PlannedTask("robot", "drill")])
    with pytest.raises(EstimateError, match=r"unknown task of arm 'drill'\n.*bring, polish, weld"):
        estimate_cycles(folder / "model", folder / "dataset", unknown)
    with pytest.raises(EstimateError, match="names places"):
        estimate_cycles(folder / "model", folder / "dataset", TaskSequence("a", ("home", "left")))


def test_a_model_is_read_as_it_was_written_and_a_damaged_one_is_refused(coupled, tmp_path) -> None:
    folder, model = coupled
    assert load_task_times(folder / "model").card == model.card
    (tmp_path / "model.json").write_text('{"format": "cyclekit-task-times", "model_version": 9}', encoding="utf-8")
    with pytest.raises(ModelError, match="model_version"):
        load_task_times(tmp_path)


def test_a_network_on_task_lists_is_refused_with_what_works(coupled) -> None:
    with pytest.raises(DatasetError, match="positions of robot and people"):
        train_model(coupled[0] / "dataset")


@pytest.mark.parametrize(("digits", "lag_s"), [(3, 0.06), (0, 0.6)])
def test_planned_starts_are_waited_for_only_where_they_decide(digits: int, lag_s: float) -> None:
    rng = np.random.default_rng(5)
    runs = []
    for number in range(30):
        planned = np.cumsum(rng.uniform(3.0, 9.0, 4))
        at, tasks = 0.0, []
        for start in planned:
            begin = max(at, start) + 0.05
            at = begin + rng.uniform(3.0, 6.0)
            tasks.append(DoneTask("pick", begin, at, round(start, digits)))
        runs.append(Run(str(number), {"arm": tuple(tasks)}))
    starts = learn_starts(runs, "arm")["pick"]
    assert starts.planned
    assert starts.lags_s.max() < lag_s
    without = [
        Run(run.name, {"arm": tuple(DoneTask(t.task, t.start_s, t.end_s) for t in run.tasks["arm"])}) for run in runs
    ]
    assert not learn_starts(without, "arm")["pick"].planned


@given(st.floats(0.3, 2.5), st.integers(0, 10_000))
def test_a_rate_is_found_whatever_it_is(rate: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    runs = []
    for number in range(120):
        work, since = 5.0 * np.exp(0.05 * rng.standard_normal()), rng.uniform(-8.0, 4.0)
        until = since + rng.uniform(2.0, 10.0)
        runs.append(Run(str(number), {"arm": (DoneTask("weld", 0.0, _end(work, since, until, rate)),),
                                      "worker": (DoneTask("pack", since, until),)}))  # fmt: skip
    found = fit_rates(runs, [("arm", "weld")])["arm", "weld"]
    assert found.rates["worker: pack"] / found.rates[""] == pytest.approx(rate, rel=0.12)


def test_of_two_robots_the_times_of_the_one_that_ends_last_make_up_the_cycle_time() -> None:
    rng = np.random.default_rng(1)
    lasts = {"arm": ("weld", 5.0), "rover": ("carry", 3.0), "worker": ("pack", 4.0)}
    runs = []
    for number in range(12):
        ends = {agent: took + rng.uniform(0.0, 0.2) for agent, (_, took) in lasts.items()}
        runs.append(Run(str(number), {agent: (DoneTask(lasts[agent][0], 0.0, end),) for agent, end in ends.items()}))
    model = learn_runs(runs, {"arm": "robot", "rover": "robot", "worker": "operator"}, folds=0)
    plan = TaskSequence.of_plan("all", [PlannedTask(agent, task) for agent, (task, _) in lasts.items()])
    (found,) = estimate_plans(model, [plan], refused=lambda _sequence, error: pytest.fail(str(error)))
    assert found.nominal_s == pytest.approx(5.1, abs=0.1)
    assert found.nominal_s + found.safety_loss_s + found.wait_s + found.idle_s == pytest.approx(found.expected_s)


def test_the_bias_on_one_order_has_the_standard_error_of_its_executions() -> None:
    rng = np.random.default_rng(2)
    runs = [Run(str(at), {"arm": (DoneTask("weld", 0.0, 5.0 + rng.uniform(0.0, 1.0)),)}) for at in range(20)]
    held_out = learn_runs(runs, {"arm": "robot"}, folds=2).held_out
    assert held_out is not None
    assert 0.005 < held_out.within < 0.03
    assert abs(held_out.bias) < 2.0 * held_out.within


def _end(work: float, since: float, until: float, rate: float) -> float:
    """Return when work that begins at 0 is done, at `rate` from `since` to `until` and at 1 else."""
    t, left = 0.0, work
    for edge, speed in ((max(since, 0.0), 1.0), (max(until, 0.0), rate)):
        if left <= (edge - t) * speed:
            return t + left / speed
        left, t = left - max(edge - t, 0.0) * speed, max(edge, t)
    return t + left


def test_few_executions_are_refused(tmp_path) -> None:
    simulate_task_lists(tmp_path / "logs", executions=3, seed=1)
    ingest([tmp_path / "logs" / "tasks.csv"], tmp_path / "dataset")
    with pytest.raises(DatasetError, match="executions whose tasks all have an end: 3; 5 are needed"):
        learn_task_times(Dataset.open(tmp_path / "dataset"))


def test_task_times_are_learned_on_one_thread(coupled, monkeypatch) -> None:
    folder, model = coupled
    threads = set()

    def learned_here(*_: object, **__: object) -> TaskModelCard:
        threads.update(each["num_threads"] for each in threadpool_info() if each["user_api"] == "blas")
        return model.card

    monkeypatch.setattr("cyclekit.learning.task_times.learn.learn_runs", learned_here)
    with threadpool_limits(2, "blas"):
        learn_task_times(Dataset.open(folder / "dataset"))
    assert threads == {1}


def test_a_task_that_takes_longer_each_time_in_an_execution_is_learned_so(tmp_path) -> None:
    options = ListOptions(coupled=False, parallel_rates=False, fatigue=0.2)
    card = learn_runs(*logged_runs(listed(tmp_path, 4, options)), folds=0)
    rolled = roll_plan(card, [PlannedTask("worker", "pack")] * 3, cycles=500)
    took = (rolled.end_s - rolled.start_s).mean(axis=0)
    assert took[1:] / took[0] == pytest.approx([1.2, 1.4], abs=0.06)


@pytest.mark.slow
def test_where_the_operator_becomes_quicker_a_plan_takes_what_it_takes_now(tmp_path) -> None:
    options = ListOptions(drift=0.3)
    card = learned(tmp_path, 6, options).card
    assert card.pace["worker"].change == pytest.approx(np.log(0.7), abs=0.1)
    assert list(card.pace) == ["worker"]
    order = random_order(np.random.default_rng(5))
    found = estimate_cycles(tmp_path / "model", tmp_path / "dataset", plan_of(order))
    true_s = np.mean(fresh_durations(order, cycles=200, seed=1, options=options))
    assert found[0].expected_s == pytest.approx(true_s, rel=0.04)
    assert any("worker becomes" in text and "quicker over 40 executions" in text for text in found[0].warnings)
    drifts = [ListOptions(drift=drift) for drift in (0.0, 0.1, 0.2, 0.3)]
    past = [fresh_durations(order, cycles=100, seed=1, options=each) for each in drifts]
    assert found[0].mean_pace_s == pytest.approx(np.mean(past), rel=0.04)
    assert any(f"mean pace of the logged executions {found[0].mean_pace_s:.1f} s" in each for each in found[0].warnings)


KINDS = {"bring": "robot", "weld": "robot", "polish": "robot", "mount": "operator", "pack": "operator"}
WORK = TaskJobs(task=tuple(JobTask(agent, name, 2) for name, agent in KINDS.items()))


def test_plan_orders_the_work_of_both_agents_close_to_the_best_order(coupled, tmp_path) -> None:
    folder, _ = coupled
    found = plan_order(folder / "model", folder / "dataset", WORK, out=tmp_path / "planned.toml")
    assert isinstance(found, TaskOrderPlan)
    order = {agent: [task.name for task in found.tasks if task.agent == agent] for agent in ("robot", "operator")}
    took = np.mean(fresh_durations(order, cycles=100, seed=1))
    rng, others = np.random.default_rng(1), []
    for _ in range(60):
        other = {agent: list(rng.permutation(tasks)) for agent, tasks in order.items()}
        try:
            others.append(np.mean(fresh_durations(other, cycles=20, seed=1)))
        except ValueError:  # cannot be done
            continue
    assert took <= 1.03 * min(others)
    assert found.saves_s[0] > 0.0
    (again,) = estimate_cycles(folder / "model", folder / "dataset", tmp_path / "planned.toml")
    assert again.expected_s == pytest.approx(found.estimate.expected_s)


def test_work_that_cannot_be_ordered_is_refused(coupled) -> None:
    folder, _ = coupled
    circle = TaskJobs(
        task=(JobTask("robot", "bring"), JobTask("robot", "weld")), before=(("bring", "weld"), ("weld", "bring"))
    )
    with pytest.raises(EstimateError, match="no order is possible"):
        plan_order(folder / "model", folder / "dataset", circle)
    with pytest.raises(ConfigError, match="places to visit"):
        plan_order(folder / "model", folder / "dataset", Jobs(("a", "b"), "home"))


CHANGES = [
    Change("faster", faster={"operator": 1.5}),
    Change("alone", no_wait=(("weld", "mount"), ("mount", "bring"))),
    Change("buffer", buffer={"mount": 1}),
    Change("thresholds", frequency=0.5),
    Change("no such wait", no_wait=(("pack", "bring"),)),
]


def test_what_if_answers_a_faster_operator_a_removed_wait_and_a_buffer(coupled) -> None:
    folder, _ = coupled
    order = {"robot": ["bring", "bring", "weld", "weld"], "operator": ["inspect", "mount", "mount"]}
    found = what_if(folder / "model", folder / "dataset", plan_of(order), CHANGES)
    by_name = {one.change: one for one in found}
    assert set(by_name) == {"faster", "alone", "buffer"}
    own = plan_of({"robot": ["bring"], "operator": ["inspect", "pack", "inspect"]})
    (faster,) = what_if(folder / "model", folder / "dataset", own, CHANGES[0])
    assert faster.saves_s[0] == pytest.approx(18.0 / 3.0, abs=0.5)
    without = np.mean(fresh_durations(order, cycles=200, seed=1, options=ListOptions(coupled=False)))
    assert by_name["alone"].after.expected_s == pytest.approx(without, rel=0.03)
    assert by_name["buffer"].saves_s[1] <= by_name["buffer"].saves_s[0] <= by_name["buffer"].saves_s[2]
    reasons = {one.name: str(one.error) for one in found.refused}
    assert "task lists hold neither" in reasons["thresholds"]
    assert "mount for bring" in reasons["no such wait"]


def test_the_report_has_a_time_chart_and_who_waits_for_what_and_what_is_not_known(coupled, tmp_path) -> None:
    folder, _ = coupled
    order = {"robot": ["bring", "weld"], "operator": ["inspect", "mount"]}
    asked = {"model": folder / "model", "sequences": plan_of(order, "plan 3"), "what_if": [CHANGES[0]]}
    facts = write_report(folder / "dataset", tmp_path / "page.html", **asked)
    page = (tmp_path / "page.html").read_text(encoding="utf-8")
    assert facts.pictures == 2  # the plan, and logged executions, none of which does its work
    assert "<title>robot: 2 weld: " in page
    assert "“plan 3” takes " in facts.headline
    write_report(folder / "dataset", tmp_path / "page.md", **asked)
    words = (tmp_path / "page.md").read_text(encoding="utf-8")
    assert "operator: mount (" in words
    assert "| arm | weld | 120 |" in words
    assert "Positions, distances, zones and the safety function are unknown" in words
    assert "| faster | plan 3 |" in words


@pytest.mark.usefixtures("words_only")
def test_the_report_of_task_lists_holds_today_and_plans_against_the_takt(coupled, tmp_path) -> None:
    folder, _ = coupled
    logged = Dataset.of(folder / "dataset")
    tasks = logged.every_task().sort("start_s").filter(execution=logged.card.executions[0].execution)
    order = {agent: tasks.filter(agent=agent)["task"].to_list() for agent in ("robot", "operator")}
    again = {"robot": ["polish", *order["robot"]], "operator": order["operator"]}
    asked = {"model": folder / "model", "sequences": [plan_of(order, "same"), plan_of(again, "more")], "takt_s": 60.0}
    write_report(folder / "dataset", tmp_path / "page.json", **asked)
    found = json.loads((tmp_path / "page.json").read_text(encoding="utf-8"))
    same = next(each for each in found["estimates"] if each["name"] == "same")
    assert found["verdict"]["today"]["executions"] == 40  # all do the same work
    mean_s = logged.executions["duration_s"].mean()
    assert found["verdict"]["today"]["mean_s"] == pytest.approx(mean_s)
    assert found["verdict"]["today"]["within"][0] == pytest.approx((logged.executions["duration_s"] <= 60.0).mean())
    assert found["verdict"]["best"]["sequence"] == "same"
    assert found["verdict"]["best"]["within"][0] == pytest.approx(same["takt_probability"][0])
    assert found["verdict"]["best"]["saves_s"] == pytest.approx(mean_s - same["expected_s"])
    assert "of cycles within the takt of 60 s" in found["headline"].replace("\N{NO-BREAK SPACE}", " ")
    ends = [task["end_high_s"] for task in same["plan"]]
    assert max(ends) == pytest.approx(same["quantiles_s"]["0.95"], rel=0.01)
    named = write_report(folder / "dataset", tmp_path / "page.html", **asked, baseline="same").headline
    duration_s = logged.executions["duration_s"][0]
    assert named.startswith(f"“same” (baseline) {duration_s:.1f}")


def test_evaluate_names_a_pace_that_changed_since_the_training(coupled, tmp_path) -> None:
    folder, _ = coupled
    same = evaluate_task_times(folder / "model", folder / "dataset", trained_on=folder / "dataset")
    assert not any(shift.changed for shift in same.drift or ())
    assert abs(same.bias) < 0.02
    quicker = ListOptions(drift=0.25)
    simulate_task_lists(tmp_path / "logs", executions=20, seed=8, options=quicker, first=1.0)
    ingest([tmp_path / "logs" / "tasks.csv"], tmp_path / "newer")
    found = evaluate_task_times(folder / "model", tmp_path / "newer", trained_on=folder / "dataset")
    by_agent = {shift.agent: shift for shift in found.drift or ()}
    assert not by_agent["arm"].changed
    assert by_agent["worker"].change == pytest.approx(-0.25, abs=0.05)
    assert "durations of worker since the training: CHANGED by -2" in found.said()
