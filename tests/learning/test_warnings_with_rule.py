"""Warnings of a model in which a rule answers instead of the network."""

from __future__ import annotations

from cyclekit.dataset.cards import note
from cyclekit.dataset.cards.rule import LawCard, LimitCard, MetresCard, RegionCard, RuleCard, SignalCard
from cyclekit.learning.training import warnings_with_rule

WARNINGS = (note("model-beaten", text="train again"), note("levels-many", levels=99), note("frame-assumed"))


def test_where_a_rule_answers_nobody_is_sent_to_train_a_better_network() -> None:
    stop = LimitCard(scaling=0.0, within=RegionCard(signals=(SignalCard(signal="stop", value="1"),)))
    rule = RuleCard(family="table of signals", levels=(0.0, 1.0), limits=(stop,), explained=1.0)
    assert [one.code for one in warnings_with_rule(WARNINGS, rule)] == ["levels-many", "frame-assumed"]


def test_where_a_law_answers_doubts_of_levels_do_not_matter_either() -> None:
    lengths = {name: MetresCard(value=value) for name, value in (("stop", 0.5), ("linear", 1.0), ("square", 0.5))}
    law = LawCard(distance="distance TCP to operator", **lengths)
    rule = RuleCard(family="law", levels=(0.0, 1.0), law=law, explained=1.0)
    assert [one.code for one in warnings_with_rule(WARNINGS, rule)] == ["frame-assumed"]
