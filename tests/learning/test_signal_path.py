"""Where on the robot's path a signal of people counts: read back, and drawn from above."""

from __future__ import annotations

import re
from types import SimpleNamespace
from typing import ClassVar

import numpy as np
import polars as pl
import pytest

from cyclekit.dataset.cards import OperatorSignalCard, TrainingCard
from cyclekit.dataset.cards.rule import LimitCard, MetresCard, RectangleCard, RegionCard, RuleCard, SignalCard
from cyclekit.learning.rules.ladder import RuleSearch
from cyclekit.learning.safety_function import answer, read_zones

SIGNALS = tuple(OperatorSignalCard(name=name, signal=name, occupied="1") for name in ("warning", "stop"))
LEFT = RectangleCard(along=(None, None), across=(MetresCard(value=0.0), None))
RULE = RuleCard(
    family="table of signals",
    levels=(0.0, 0.5, 1.0),
    limits=(
        LimitCard(scaling=0.0, within=RegionCard(signals=(SignalCard(signal="stop", value="1", robot=LEFT),))),
        LimitCard(scaling=0.5, within=RegionCard(signals=(SignalCard(signal="warning", value="1"),))),
    ),
    explained=1.0,
)


class Cell:
    """A dataset whose robot goes along y from -1 to 1 m, at z 0.2 m."""

    card = SimpleNamespace(operator_signals=SIGNALS, executions=())
    positions, people = ("robot",), "auto"
    places: ClassVar[dict[str, object]] = {}
    human_places = furniture = places

    def samples(self, columns: list[str]) -> pl.DataFrame:
        y = np.linspace(-0.99, 0.99, 199)
        robot = {"robot_x_m": 0.0 * y + 0.01, "robot_y_m": y, "robot_z_m": 0.0 * y + 0.2}
        rest = {"execution": ["one"] * len(y), "scaling": 0.0 * y, "human_signals": [0] * len(y)}
        return pl.DataFrame(robot | rest).select(columns)


@pytest.fixture
def by_network(monkeypatch: pytest.MonkeyPatch):
    """Return a network that allows 30 % whenever a signal is on; the rule search finds what `rule` holds."""
    found = {"rule": RULE}
    monkeypatch.setattr(answer, "refuse_other_cell", lambda *given, **named: None)
    monkeypatch.setattr(answer, "rule_of", lambda *given, **named: RuleSearch(found["rule"]))
    network = SimpleNamespace(
        problem="now",
        levels=RULE.levels,
        card=TrainingCard(operator_signals=SIGNALS),
        predict=lambda rows: np.where(rows[:, 3:].any(axis=1), 0.3, 1.0),
    )
    return network, found


def test_each_signal_has_a_picture_of_the_path_in_the_colour_of_its_speed_and_a_row_in_the_table(by_network) -> None:
    zones = read_zones(by_network[0], Cell())
    assert zones.path_m.shape == (40, 2)
    left = zones.path_m[:, 1] >= -1e-9
    assert zones.path_speed["stop"].tolist() == np.where(left, 0.0, 1.0).tolist()
    assert set(zones.path_speed["warning"]) == {0.5}
    assert zones.to_dict()["path_speed"]["stop"] == zones.path_speed["stop"].tolist()
    table, *paths = zones.plot().axes
    assert [axes.get_title(loc="left") for axes in paths] == [
        "warning: 50 % on 100 % of the path",
        "stop: 0 % on 50 % of the path",
    ]
    texts = [one.get_text().strip() for one in table.texts]
    assert texts[4:] == ["stop", "1", "at y above 0.000 m", "0 %", "warning", "1", "anywhere", "50 %"]


def test_without_a_rule_the_network_is_asked_on_the_path(by_network) -> None:
    network, found = by_network
    found["rule"] = None
    zones = read_zones(network, Cell())
    assert set(zones.path_speed["stop"]) == {0.3}
    table, *_ = zones.plot().axes
    assert [one.get_text() for one in table.texts] == ["no rule explains the logs: speeds by the network"]


def test_of_many_speeds_of_a_network_the_title_names_the_range(by_network) -> None:
    network, found = by_network
    found["rule"] = None
    network.predict = lambda rows: np.where(rows[:, 3:].any(axis=1), 0.3 + 0.2 * np.abs(rows[:, 1]), 1.0)
    _, *paths = read_zones(network, Cell()).plot().axes
    assert re.fullmatch(r"stop: 30 to (49|50) % on 100 % of the path", paths[1].get_title(loc="left"))


def test_without_positions_of_people_no_thresholds_are_listed() -> None:
    from cyclekit.cli.zones import _thresholds

    assert _thresholds(SimpleNamespace(thresholds=())) == ""
