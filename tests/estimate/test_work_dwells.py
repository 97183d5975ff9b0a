"""Products with different process times at the same places: an order takes the standstills of its own work."""

from __future__ import annotations

from itertools import pairwise
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import numpy as np
import polars as pl
import pytest
from known_cells import TrueStaircase
from known_products import P, Q, products
from made_once import simulated
from scipy.stats import kruskal

from cyclekit.config.sequences import TaskSequence
from cyclekit.dataset.dataset import Dataset
from cyclekit.estimate.plan import Jobs, plan
from cyclekit.estimate.robot.nominal import NominalTask, nominal_tasks
from cyclekit.estimate.robot.work_dwells import either_kind, said_of_places, standstills_by_work
from cyclekit.estimate.rollout import estimate, lay_out
from cyclekit.estimate.statistics.same_work import work_of
from cyclekit.ingest.ingest import ingest
from cyclekit.inspect.describe import describe
from cyclekit.segmentation.rank_test import by_chance
from cyclekit_sim import simulate, simulate_sequence
from cyclekit_sim.options import SimulationOptions

__all__ = ["products"]

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

PICK_S = 0.6


def stands_s(products: Dataset, places: tuple[str, ...]) -> float:
    program = lay_out(TaskSequence("asked", places), nominal_tasks(products), products)
    return float(sum(np.median(task.standstill_s) for task in program.tasks if task.task.endswith("->conveyor")))


def test_an_order_takes_the_standstills_of_its_own_work(products: Dataset):
    assert stands_s(products, P.places) == pytest.approx(2 * (4.0 + PICK_S), abs=0.1)
    assert stands_s(products, Q.places) == pytest.approx(9.0 + PICK_S, abs=0.1)


@pytest.mark.parametrize("estimator", ["rollout", "history", "nominal"])
def test_every_estimator_uses_them_and_says_so(products: Dataset, estimator: str):
    asked = [TaskSequence("P", P.places), TaskSequence("Q", Q.places)]
    for found in estimate(TrueStaircase(), products, asked, estimator=estimator):
        product = {"P": P, "Q": Q}[found.name]
        visits = product.places.count("conveyor")
        own_s = visits * (product.process_s["conveyor"] + PICK_S) + 0.5 * (len(product.places) - 2 - visits)
        assert found.dwell_s + found.wait_s == pytest.approx(own_s, abs=0.3)
        assert any(
            "standstill at conveyor depends on the work: 4.6 s in" in text and "9.6 s in" in text
            for text in found.warnings
        )
        assert found.combined is None  # history holds both products


def test_an_order_of_other_work_names_the_times_and_its_intervals_cover_both(products: Dataset):
    longer = ("home", "conveyor", "left_1", "conveyor", "left_1", "conveyor", "right_1", "home")
    (found,) = estimate(TrueStaircase(), products, [TaskSequence("more", longer)], validate=False)
    assert any("standstill at conveyor depends on the work" in text for text in found.doubts)
    for product in (P, Q):
        off = 3 * (product.process_s["conveyor"] + PICK_S) - stands_all(products, longer)
        assert found.expected_low_s <= found.expected_s + off <= found.expected_high_s
    assert found.quantiles_s[0.05] < found.expected_low_s < found.expected_high_s < found.quantiles_s[0.95]


def stands_all(products: Dataset, places: tuple[str, ...]) -> float:
    tasks = lay_out(TaskSequence("asked", places), nominal_tasks(products), products).tasks
    return sum(task.dwell_s + task.wait_s for task in tasks if task.task.endswith("->conveyor"))


def test_the_order_to_be_found_takes_them_too(products: Dataset, monkeypatch: pytest.MonkeyPatch):
    class Seen(Exception):
        pass

    def look(_: Any, tasks: Any, *args: Any, **more: Any) -> None:
        assert tasks["home->conveyor"].dwell_s + tasks["home->conveyor"].wait_s == pytest.approx(4.6, abs=0.1)
        raise Seen

    monkeypatch.setattr("cyclekit.estimate.plan.answer.transit_table", look)
    with pytest.raises(Seen):
        plan(TrueStaircase(), products, Jobs(("left_1", "right_1"), "home", "home", "conveyor"), validate=False)


def test_inspect_names_the_place_and_the_times(products: Dataset):
    (said,) = [text for text in describe(products.path).warnings if "depends on the work" in text]
    assert said.startswith("standstill at conveyor depends on the work: 4.6 s in 5 visits")


def test_a_cell_of_one_work_stays_as_it_is(logged: Dataset):
    assert standstills_by_work(logged) == {}
    assert all(task.key == task.task for task in nominal_tasks(logged).values())


def rows(cycles: Sequence[tuple[Sequence[str], dict[str, float]]]) -> Any:
    """Return what is asked of a dataset, with one execution per cycle: its places, and the dwell at some."""
    table, cards = [], []
    for number, (places, dwell_s) in enumerate(cycles):
        cards.append(SimpleNamespace(execution=str(number), places=tuple(places), whole=True))
        for start, goal in pairwise(places):
            stand = dwell_s.get(goal, 1.0) + 0.01 * (number % 3)
            table.append((str(number), f"{start}->{goal}", goal, 1.0, stand, 0.0, False))
    names = ["execution", "task", "goal_place", "nominal_s", "dwell_s", "wait_s", "cut"]
    frame = pl.DataFrame(table, names, orient="row")
    return SimpleNamespace(tasks=lambda: frame, card=SimpleNamespace(executions=cards))


def test_executions_of_the_same_places_are_told_apart_by_their_order():
    there, back = "abcdbca", "abdcbca"
    found = standstills_by_work(rows([(there, {"b": 2.0}), (back, {"b": 5.0})] * 8))
    assert set(found["a->b"]) == {tuple(there), tuple(back)}
    assert found["a->b"][tuple(back)].mean_s == pytest.approx(5.01, abs=0.02)


def test_works_that_differ_in_the_number_of_visits_only_share_their_places():
    often = [("a" + "bc" * n + "a", {"b": 2.0}) for n in range(1, 9)]
    found = standstills_by_work(rows(often + [(f"{one[:-1]}da", {"b": 5.0}) for one, _ in often]))
    groups = {frozenset("abc"), frozenset("abcd")}
    assert {task: set(stands) for task, stands in found.items()} == {"a->b": groups, "c->b": groups}
    assert found["a->b"][frozenset("abc")].mean_s == pytest.approx(2.01, abs=0.02)
    assert said_of_places(found) == [
        "standstill at b depends on the work: 2.0 s in cycles through a, b, c, 5.0 s in cycles through a, b, c, d"
    ]


ORDERS = ["abcda", "acbda", "adbca", "abdca", "acdba", "adcba"]


def test_standstills_of_two_kinds_are_named_and_taken_together_for_a_new_order():
    """Two products with the same visits. A new order may be of either, a logged one is of the one that it had."""
    found = standstills_by_work(rows([(order, {"b": (3.0, 9.0)[i % 2]}) for i, order in enumerate(ORDERS * 4)]))
    assert set(found) == {"a->b", "c->b", "d->b"}
    (said,) = said_of_places(found)
    assert said.startswith("standstill at b is 3.0 s (in 12 executions) or 9.0 s (in 12 executions), and no logged")
    both = either_kind(found["c->b"])
    assert both is not None
    assert both.mean_s == pytest.approx(6.0, abs=0.05)
    task = NominalTask("c->b", np.zeros((2, 3)), 1.0, both.dwell_s, both.wait_s, both.standstill_s, found["c->b"])
    assert task.of_work("abca") is task
    assert task.of_work("acbda").dwell_s == pytest.approx(9.0, abs=0.05)
    assert task.of_work("adbca").dwell_s == pytest.approx(3.0, abs=0.05)


def test_kinds_of_one_place_hold_at_others_where_they_scatter_more():
    cycles = [
        (order, {"b": (3.0, 9.0)[i % 2], "c": (2.0, 2.6)[i % 2] + 0.15 * (i % 5)}) for i, order in enumerate(ORDERS * 4)
    ]
    found = standstills_by_work(rows(cycles))
    assert {task.rpartition(">")[2] for task in found} == {"b", "c"}
    assert len(said_of_places(found)) == 2


def test_products_that_share_their_orders_show_by_their_batches():
    b_s = [(3.0, 9.0)[i // 6 % 2] for i in range(36)]
    found = standstills_by_work(rows([(ORDERS[i % 6], {"b": lasts_s}) for i, lasts_s in enumerate(b_s)]))
    assert [type(group).__name__ for group in found["c->b"]] == ["StandstillKind"] * 2
    mixed = np.random.default_rng(0).permutation(b_s).tolist()  # such as a part that is scanned twice now and then
    assert standstills_by_work(rows([(ORDERS[i % 6], {"b": lasts_s}) for i, lasts_s in enumerate(mixed)])) == {}


@pytest.mark.parametrize(
    "b_s",
    [
        lambda i: 3.0 + 0.3 * i,  # a wait of any length
        lambda i: 3.0 if i else 9.0,  # once
        lambda i: 3.0 + 0.02 * (i % 7),
    ],
)
def test_standstills_without_clear_kinds_stay_as_they_are(b_s: Callable[[int], float]):
    orders = ["abcda", "acbda", "adbca", "abdca", "acdba", "adcba"] * 4
    assert standstills_by_work(rows([(order, {"b": b_s(i)}) for i, order in enumerate(orders)])) == {}


def test_a_task_that_is_rare_in_a_work_takes_what_that_work_has_at_the_place():
    cycles = [("abca", {"b": 2.0})] * 8 + [("abcda", {"b": 5.0})] * 8 + [("adcba", {"b": 5.0})]
    found = standstills_by_work(rows(cycles))
    assert found["c->b"][work_of("abcda")].mean_s == pytest.approx(5.01, abs=0.02)
    assert found["c->b"][work_of("abca")].mean_s == pytest.approx(2.01, abs=0.02)


@pytest.mark.parametrize(
    ("first", "second"),
    [
        ([("abca", {"b": 2.0})] * 8, [("abcda", {"b": 2.15})] * 8),  # too little to matter
        ([("abca", {"b": 5.0})] * 8, [("abcda", {"b": 5.4})] * 8),  # 8 %
        ([("abda", {"b": 2.0})] * 8, [("acbea", {"b": 5.0})] * 8),  # by the way that leads there, not by the work
        ([("abca", {"b": x}) for x in (2, 5) * 4], [("abcda", {"b": x}) for x in (5, 2) * 4]),  # the same in both
    ],
)
def test_nothing_is_told_apart_that_the_logs_do_not_show(first: Any, second: Any):
    assert standstills_by_work(rows([*first, *second])) == {}


@pytest.mark.parametrize(("first", "second"), [(8, 4), (3, 3)])
def test_so_few_executions_that_no_difference_could_be_shown_leave_it_open(first: int, second: int):
    """Standstills of all are taken, and those of each work are covered; two executions tell nothing."""
    found = standstills_by_work(rows([("abca", {"b": 2.0})] * first + [("abcda", {"b": 5.0})] * second))
    assert set(found) == {"a->b"}
    assert sorted((round(one.mean_s), group.few) for group, one in found["a->b"].items()) == [(2, True), (5, True)]
    (said,) = said_of_places(found)
    assert said.endswith("too few of each work to show a difference")
    assert standstills_by_work(rows([("abca", {"b": 2.0})] * 2 + [("abcda", {"b": 5.0})] * 2)) == {}


def test_the_interval_of_a_product_logged_few_times_covers_its_own_process(tmp_path: Path):
    logs = simulate("box-picking", tmp_path / "logs", executions=8, seed=6, options=SimulationOptions(products=(P, Q)))
    ingest([logs], tmp_path / "dataset")
    dataset = Dataset.open(tmp_path / "dataset")
    for product in (P, Q):
        asked = TaskSequence("asked", product.places)
        (found,) = estimate(TrueStaircase(), dataset, [asked], validate=False, extrapolate=True)
        own = [one.execution for one in dataset.card.executions if work_of(one.places) == work_of(product.places)]
        logged_s = dataset.executions.filter(pl.col("execution").is_in(own))["duration_s"].mean()
        assert found.expected_low_s <= logged_s <= found.expected_high_s


def test_the_probability_is_that_of_the_rank_test():
    rng = np.random.default_rng(0)
    for shift in (0.0, 0.5, 1.0):
        groups = [np.round(rng.normal(number * shift, 1.0, 9), 1) for number in range(3)]
        ours = by_chance(np.concatenate(groups), np.repeat(np.arange(3), 9))
        assert ours == pytest.approx(kruskal(*groups).pvalue, rel=1e-9)
    assert by_chance(np.ones(9), np.arange(9) % 3) == 1.0


def test_the_simulated_product_needs_its_time_at_its_places():
    plain = simulate_sequence("box-picking", Q.places, executions=2, seed=1)
    ours = simulate_sequence("box-picking", Q.places, executions=2, seed=1, options=SimulationOptions(products=(Q,)))
    stood = (ours["dwell_s"] + ours["wait_s"]) - (plain["dwell_s"] + plain["wait_s"])
    assert stood.to_list() == pytest.approx([9.0, 9.0])


@pytest.mark.parametrize("inferred", [False, True])
def test_the_longer_process_is_no_wait_and_no_safety_loss(
    tmp_path_factory: pytest.TempPathFactory, tmp_path: Path, products: Dataset, inferred: bool
):
    found = products
    truth = simulated(tmp_path_factory, "box-picking", 14, seed=6, products=(P, Q)) / "truth" / "tasks.parquet"
    if inferred:
        options = SimulationOptions(products=(P, Q), log_override=False, log_outputs=False)
        logs = simulate("box-picking", tmp_path / "logs", executions=14, seed=6, options=options)
        found = Dataset.open(ingest([logs], tmp_path / "dataset").dataset)
    parts = pl.col("safety_loss_s", "dwell_s", "wait_s").sum()
    lost_s, dwell_s, wait_s = found.tasks().select(parts).row(0)
    true_lost_s, *true_stood_s = pl.read_parquet(truth).select(parts).row(0)
    assert wait_s < 0.5
    assert dwell_s == pytest.approx(sum(true_stood_s), rel=0.02)
    assert lost_s == pytest.approx(true_lost_s, rel=0.05)
