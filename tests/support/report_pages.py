"""What the tests of the report share: a model, its judgement, an estimate, and the page as a browser sees it."""

from __future__ import annotations

import html.parser
import re

import numpy as np
from fabricated import THRESHOLDS_M

from cyclekit.dataset.cards import MetricsCard, TrainingCard
from cyclekit.estimate.result import CycleEstimate, TaskShare
from cyclekit.estimate.statistics.distribution import CycleDistribution
from cyclekit.report.pictures import Picture


def draw_only(name, monkeypatch):
    """Let pages of the test have this picture alone, the others empty: drawing takes most of the time."""
    drawn = Picture._drawn
    monkeypatch.setattr(Picture, "_drawn", lambda one, *how: drawn(one, *how) if one.name == name else "<svg></svg>")


class DistanceModel:
    """The true staircase as a model of problem `now`, with the card of a trained one."""

    problem, network = "now", "classifier"

    def __init__(self):
        metrics = MetricsCard(rows=1234, mse_mean=3.2e-4, accuracy=0.991, mae=0.0081, bias=0.0)
        self.card = TrainingCard(cyclekit="0.1.0", metrics=metrics)

    def predict(self, x):
        distance = np.linalg.norm(x[:, :3] - x[:, 3:], axis=1)
        return np.searchsorted(np.array(THRESHOLDS_M), distance) / 4


class Judgement:
    def to_dict(self):
        return {
            "mse": [{"name": "classifier", "mse": 3.2e-4, "note": ""}, {"name": "always 1", "mse": 0.21, "note": "x"}],
            "accuracy": 0.98,
            "confusion": [[9, 1], [0, 10]],
            "levels": [{"level": 0.0}, {"level": 1.0}],
            "held_out": True,
            "notes": ["Two executions were left out."],
        }


def cycles_of(quantiles_s: dict[float, float]) -> CycleDistribution:
    """Cycles with these quantiles, and straight lines between them."""
    levels = np.arange(1, 100) / 100
    return CycleDistribution(np.interp(levels, list(quantiles_s), list(quantiles_s.values())))


def estimate(name="A first", mean_s=30.0, half_s=0.6, **changes):
    tasks = (
        TaskShare("conveyor->left", mean_s / 2, 5.0, mean_s / 2 - 6.0, 1.0, 0.0),
        TaskShare("left->conveyor", mean_s / 2, 8.0, mean_s / 2 - 9.0, 1.0, 0.0),
    )
    facts = {
        "name": name,
        "places": ("conveyor", "left", "conveyor"),
        "expected_s": mean_s,
        "expected_low_s": mean_s - half_s,
        "expected_high_s": mean_s + half_s,
        "distribution": cycles_of({0.05: mean_s - 4, 0.5: mean_s, 0.95: mean_s + 5}),
        "nominal_s": 13.0,
        "safety_loss_s": mean_s - 15.0,
        "dwell_s": 2.0,
        "wait_s": 0.0,
        "support": 0.97,
        "tracks": 40,
        "limits": (),
        "tasks": tasks,
        "safety_by_activity_s": {"shelf": 4.0},
        "durations_s": (mean_s,) * 3,
    }
    return CycleEstimate(**{**facts, **changes})


class Page(html.parser.HTMLParser):
    """The page as a browser sees it: elements in order, and what does not nest."""

    VOID = frozenset({"meta", "link", "br", "img", "hr", "path", "use", "image", "rect", "input"})

    def __init__(self, text):
        super().__init__()
        self.elements, self.open, self.faults, self.words = [], [], [], []
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.elements.append((tag, dict(attrs)))
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        self.elements.append((tag, dict(attrs)))

    def handle_endtag(self, tag):
        if tag in self.VOID:
            return
        if not self.open or self.open.pop() != tag:
            self.faults.append(tag)

    def handle_data(self, data):
        self.words.append(data)

    @property
    def text(self):
        return re.sub(r"\s+", " ", " ".join(self.words))

    def all(self, tag):
        return [attrs for name, attrs in self.elements if name == tag]
