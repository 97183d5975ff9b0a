"""What the contract calls worse: errors that grow, orders no longer answered, ranges that hold too little."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from benchmarks.contract.__main__ import QUICK, main, wanted_rows
from benchmarks.contract.cells import CELLS, Free, Listed, Waiting, of_length
from benchmarks.contract.compare import faults, key_of, summary
from benchmarks.contract.measure import row_of

CONTRACT = Path(__file__).parents[2] / "benchmarks" / "contract" / "contract.json"


def row(errors: list[float], *, cell: str = "box-picking", inside: float = 0.9) -> dict[str, Any]:
    orders = [
        {"name": str(n), "error": error, "chance": 0.005, "held": True, "inside": inside}
        for n, error in enumerate(errors)
    ]
    return {"cell": cell, "kind": "tracker", "executions": 20, "seed": 1, "refused": {}, "orders": orders}


def test_the_stored_contract_is_whole_and_names_no_path_of_a_machine() -> None:
    stored = json.loads(CONTRACT.read_text(encoding="utf-8"))
    assert {key_of(one) for one in stored} == set(wanted_rows())
    reasons = [reason for one in stored for reason in one["refused"].values()]
    assert reasons
    assert not [reason for reason in reasons if "/" in reason.partition(":")[0]]


def test_a_row_that_is_as_good_is_no_fault() -> None:
    assert faults([row([0.01, -0.01])], [row([-0.01, 0.01])]) == []


def test_an_error_that_grows_by_more_than_three_tenths_of_a_point_is_named_with_both_numbers() -> None:
    worse = faults([row([0.01, -0.01])], [row([0.014, -0.014])])
    assert "box-picking, tracker, 20 executions, seed 1: mean |error| 1.00 -> 1.40 %" in worse[0]


def test_many_small_growths_are_named_by_their_mean() -> None:
    cells = [f"cell {n}" for n in range(4)]
    old, new = ([row([error], cell=name) for name in cells] for error in (0.01, 0.011))
    assert faults(old, new) == ["mean over 4 common rows: +0.100 points"]


def test_an_order_that_is_no_longer_answered_is_named_with_its_reason() -> None:
    new = row([0.01])
    new["refused"] = {"1": "too few executions"}
    assert "1 orders no longer answered: too few executions" in faults([row([0.01, 0.01])], [new])[0]


def test_ranges_that_hold_too_few_or_too_many_executions_are_named() -> None:
    for inside in (0.85, 0.95):
        (fault,) = faults([], [row([0.0], inside=inside)])
        assert f"hold {inside:.1%}" in fault


def test_the_summary_counts_what_was_not_answered() -> None:
    refused = row([])
    refused["refused"] = {"0": "no way", "1": "no way"}
    assert summary([refused]) == "1 rows, no order answered, 2 refused"


def test_rows_that_the_file_has_are_compared_without_being_measured_again(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rows = [row([0.02]) | {"cell": key[0], "kind": key[1], "executions": key[2], "seed": key[3]} for key in QUICK]
    better = [each | {"orders": [order | {"error": 0.0} for order in each["orders"]]} for each in rows]
    for name, some in (("new", rows), ("old", better)):
        (tmp_path / f"{name}.json").write_text(json.dumps(some), encoding="utf-8")
    words = ["--quick", "--out", str(tmp_path / "new.json"), "--compare"]
    assert main([*words, str(tmp_path / "new.json")]) == 0
    assert main([*words, str(tmp_path / "old.json")]) == 1
    assert "worse: box-picking, tracker" in capsys.readouterr().err


def test_the_rows_cover_every_cell_with_few_and_more_executions_and_the_quick_ones_are_among_them() -> None:
    rows = wanted_rows()
    assert {key[0] for key in rows} == set(CELLS)
    assert {key[1] for key in rows} == {"tracker", "signals", "list", "robot"}
    assert len(CELLS) >= 12
    assert set(QUICK) <= set(rows)
    assert len({key for key in rows if key[2] == 200}) * 3 >= len({key[:2] for key in rows})


def test_an_order_of_half_and_of_twice_the_length_repeats_pairs_of_places() -> None:
    places = ["home", "a", "b", "a", "c", "home"]
    assert of_length(places, 0.5) == ["home", "a", "b", "home"]
    assert of_length(places, 2.0) == ["home", "a", "b", "a", "c", "a", "b", "a", "c", "home"]


@pytest.mark.parametrize(
    ("cell", "kind"),
    [
        (Free("scanner-fields", ("signals",)), "signals"),
        (Waiting("handover"), "robot"),
        (Waiting("shared-zone"), "list"),
        (Listed(), "list"),
    ],
)
def test_a_cell_runs_an_order_freshly_and_beside_the_luck_of_its_logs(cell: Any, kind: Any) -> None:
    (asked,) = cell.orders(kind, 1)
    fresh, again = cell.truth(kind, asked, 5), cell.truth(kind, asked, 5)
    beside, other = (cell.beside(kind, asked, 5, seed) for seed in (1, 2))
    assert fresh.durations_s.tolist() == again.durations_s.tolist()
    assert beside.tolist() != other.tolist()
    assert abs(beside.mean() / fresh.durations_s.mean() - 1.0) < 0.2
    assert "[[sequence]]" in asked.toml


def test_a_row_holds_the_answer_beside_the_truth_and_what_it_took(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("benchmarks.contract.measure.FRESH", 50)
    found = row_of(tmp_path, "waits and rates", "list", 20, 1, orders=1)
    assert set(found["seconds"]) == {"ingest", "train", "estimate"}
    (order,) = found["orders"]
    low_s, high_s = order["interval_s"]
    assert low_s < order["expected_s"] < high_s
    assert order["quantiles_s"] == sorted(order["quantiles_s"])
    assert len(order["true_quantiles_s"]) == len(order["quantiles_s"]) == 3
    assert order["error"] == pytest.approx(order["expected_s"] / order["true_s"] - 1.0, abs=1e-3)
    assert 0.0 <= order["within"] <= 1.0
    assert order["waits_s"][1] > 0.0
    assert order["conditions"]
