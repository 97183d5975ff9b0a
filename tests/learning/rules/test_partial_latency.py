"""A part of the latency is taken out of the samples where a rule then explains more of them."""

from __future__ import annotations

from typing import Any

import pytest

from cyclekit.dataset.cards.rule import LimitCard, RegionCard, RuleCard
from cyclekit.learning.rules.ladder import RuleSearch
from cyclekit.learning.rules.of_dataset import with_partial_latency
from cyclekit.learning.rules.samples.distances import TO_TCP

LEVELS = (0.0, 0.5, 1.0)


@pytest.mark.parametrize(("of_hysteresis_s", "chosen_s"), [(0.1, 0.1), (None, 0.3)])
def test_a_part_of_the_latency_is_taken_where_a_rule_with_hysteresis_explains_more_then(
    of_hysteresis_s: float | None, chosen_s: float
) -> None:
    kind = f"{TO_TCP}, with hysteresis" if of_hysteresis_s is not None else TO_TCP

    def search(latency_s: float, *, kinds: Any) -> RuleSearch:
        assert TO_TCP in kinds
        explained = 0.99 - (latency_s - (of_hysteresis_s or 0.0)) ** 2
        limits = (LimitCard(scaling=0.5, within=RegionCard(anywhere=True)),)
        shown: dict[str, Any] = {
            "limits": limits,
            "explained": explained,
            "network": None,
            "rows": 100,
            "executions": 5,
        }
        rule = RuleCard(family=TO_TCP, hysteresis=kind != TO_TCP, levels=LEVELS, latency_s=latency_s, **shown)
        return RuleSearch(rule, {kind: explained})

    late = RuleSearch(None, {kind: 0.95})
    found = with_partial_latency(search, 0.3, late, RuleSearch(None, {kind: 0.94}))
    assert (0.3 if found.rule is None else found.rule.latency_s) == pytest.approx(chosen_s, abs=0.03)
