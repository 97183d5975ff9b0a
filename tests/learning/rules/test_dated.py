"""The robot's log shows when the level changed between two samples."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

from cyclekit.dataset.dataset import Dataset
from cyclekit.ingest.ingest import ingest
from cyclekit.learning.rules.samples.distances import TO_LINK
from cyclekit.learning.rules.samples.rows import rows_of
from cyclekit_sim import SimulationOptions, simulate
from cyclekit_sim.rules import Limit, Rectangle, Rule

if TYPE_CHECKING:
    from pathlib import Path

FROM_M, TO_M = 1.25, 2.2
RULE = Rule((Limit(0.25, rectangle=Rectangle((FROM_M, TO_M), (-5.0, 5.0))),))


def rows(folder: Path, **options: object):
    given = SimulationOptions(rule=RULE, **options)  # type: ignore[arg-type]
    simulate("scanner-visits", folder / "logs", executions=4, seed=3, options=given)
    ingest([folder / "logs"], folder / "dataset")
    dataset = Dataset.open(folder / "dataset")
    names = dataset.executions["execution"].to_list()
    return rows_of(dataset, names, (0.25, 1.0), latency_s=0.0)


def test_changes_lie_on_the_edge_at_the_time_that_the_log_shows(tmp_path: Path) -> None:
    found = rows(tmp_path)
    changes = np.flatnonzero((found.before >= 0) & (found.level != found.level[found.before]))
    known = changes[np.isfinite(found.dated[changes, 0])]
    assert len(known) >= 0.9 * len(changes) >= 5
    assert np.isnan(np.delete(found.dated, changes, axis=0)).all()
    at, before = found.floor_m[known, 0], found.floor_m[found.before[known], 0]
    part = found.dated[known]
    assert ((part >= 0) & (part <= 1)).all()
    assert np.median(part[:, 1] - part[:, 0]) == pytest.approx(0.08, abs=0.02)  # 8 of 100 ms
    crossed = before + part.mean(axis=1) * (at - before)
    off = np.minimum(np.abs(crossed - FROM_M), np.abs(crossed - TO_M))
    assert np.median(off) < 0.005
    assert np.median(off) < 0.3 * np.median(np.abs((at - before) / 2))


def test_each_log_is_read_once_for_the_links_and_the_dates(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    read: list[str] = []
    native_robot = Dataset.native_robot

    def counted(dataset: Dataset, name: str, *columns: object, **more: object) -> object:
        read.append(name)
        return native_robot(dataset, name, *columns, **more)  # type: ignore[arg-type]

    monkeypatch.setattr(Dataset, "native_robot", counted)
    found = rows(tmp_path)
    assert TO_LINK in found.apart_m
    assert np.isfinite(found.dated).any()
    assert len(read) == len(set(read)) == 4


def test_ramps_are_dated_by_their_start(tmp_path: Path) -> None:
    found = rows(tmp_path, ramp_up_per_s=1.0, ramp_down_per_s=2.0)
    known = np.flatnonzero(np.isfinite(found.dated[:, 0]))
    before = found.before[known]
    crossed = found.floor_m[before, 0] + found.dated[known].mean(axis=1) * (
        found.floor_m[known, 0] - found.floor_m[before, 0]
    )
    assert len(known) >= 5
    assert np.median(np.minimum(np.abs(crossed - FROM_M), np.abs(crossed - TO_M))) < 0.01


def test_an_inferred_scaling_dates_nothing(tmp_path: Path) -> None:
    found = rows(tmp_path, log_override=False)
    assert np.isnan(found.dated).all()
