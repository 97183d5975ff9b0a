"""A dataset larger than memory: rows in files are learned from as those in memory; estimates say what they saw."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from msgspec import structs

from cyclekit.config.sequences import TaskSequence
from cyclekit.dataset.dataset import Dataset
from cyclekit.errors import ConfigError
from cyclekit.estimate.rollout import estimate
from cyclekit.learning.evaluation.evaluate import evaluate
from cyclekit.learning.networks import rows as model_rows
from cyclekit.learning.networks.spec import ModelSpec
from cyclekit.learning.out_of_core import frames, in_files, in_memory, memory_rows, rows_of, some_executions
from cyclekit.learning.training import train
from cyclekit.learning.windows import build_samples


@pytest.fixture
def logs(small_cell: Path) -> Dataset:
    return Dataset.open(small_cell / "dataset")


@pytest.fixture
def little_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    """Memory takes two thousand samples, two executions."""
    monkeypatch.setenv("CYCLEKIT_MEMORY_ROWS", "2000")


@pytest.mark.parametrize("network", [("now", "classifier"), ("average", "mixed"), ("ahead", "lstm-2")], ids=str)
def test_rows_in_files_are_the_rows_in_memory(logs: Dataset, network: tuple[str, str], tmp_path: Path) -> None:
    spec = ModelSpec.of(*network).at_rate(10.0)
    names = logs.executions["execution"].to_list()
    levels = (0.0, 0.25, 0.5, 0.75, 1.0)

    def build(frame):
        return build_samples(frame, spec.problem, spec.horizon_s, levels, history=spec.history, rate_hz=10.0)

    whole = build(logs.samples(names))
    kept = in_files((build(frame) for frame in frames(logs, names, rows=1000)), tmp_path)
    assert kept.in_files
    assert isinstance(kept.X, np.memmap)
    assert len(kept) == len(whole) > 4000
    for name in ("X", "step", "scaling", "weight", "model_inputs"):
        assert np.array_equal(
            getattr(kept, name), getattr(whole, name).astype(getattr(kept, name).dtype), equal_nan=True
        )
    if whole.table is not None:
        assert np.array_equal(kept.table[kept.ahead], whole.table[whole.ahead], equal_nan=True)
    assert kept.dropped == whole.dropped


@pytest.mark.parametrize("rows", [1, 4096, 50_001])
def test_blocks_hand_out_every_row_once_and_from_all_over(rows: int, monkeypatch: pytest.MonkeyPatch) -> None:
    import torch

    monkeypatch.setattr(model_rows, "_BLOCK_ROWS", 64)
    monkeypatch.setattr(model_rows, "_BLOCKS", 32)
    nothing = torch.zeros(rows)
    learn = model_rows.TrainingRows(*[nothing] * 2, nothing[:, None], *[nothing] * 5, None, None, in_blocks=True)
    batches = list(learn.batches(max(rows // 512, 1)))
    order = torch.cat(batches).tolist()
    assert sorted(order) == list(range(rows))
    if rows > 10_000:
        assert abs(len(batches) - rows // 512) < 0.1 * rows // 512
        assert all(np.ptp(batch.tolist()) > rows / 2 for batch in batches)


def test_a_model_learned_from_files_is_as_good(logs: Dataset, monkeypatch: pytest.MonkeyPatch) -> None:
    spec = ModelSpec.of("now", "regressor", epochs=8)
    whole = train(logs, spec).card
    monkeypatch.setenv("CYCLEKIT_MEMORY_ROWS", "4000")
    monkeypatch.setattr(model_rows, "_BLOCK_ROWS", 64)
    card = train(logs, spec).card
    assert card.split == whole.split
    assert card.rows == whole.rows
    assert card.metrics.mse_mean == pytest.approx(whole.metrics.mse_mean, rel=0.3)
    assert card.warnings[0].code == "learned-in-files"
    assert "learned-in-files" not in {one.code for one in whole.warnings}


def test_estimates_and_judgements_look_at_as_many_executions_as_memory_takes(
    logs: Dataset, small_cell: Path, little_memory: None
) -> None:
    from cyclekit.learning.networks.saved import load_model

    part, said = in_memory(logs)
    assert said is not None
    assert set(part.done_tasks()["task"]) == set(logs.done_tasks()["task"])
    model = load_model(small_cell / "model")
    asked = {"extrapolate": True, "validate": False}
    (found,) = estimate(model, part, [TaskSequence("one way", ("home", "conveyor"))], **asked)
    (again,) = estimate(model, logs, [TaskSequence("one way", ("home", "conveyor"))], **asked)
    assert again.durations_s == found.durations_s
    assert f"{part.executions.height} of 6 logged executions were used" in " ".join(again.warnings)
    other = structs.replace(model.card.split, train=("a",), validation=(), test=("b",))
    model = replace(model, card=structs.replace(model.card, dataset_sha256="another", split=other))
    judged = evaluate(model, logs)
    assert len(judged.executions) == 2
    assert "2 of 6 executions are evaluated" in judged.notes[0]


def test_executions_are_drawn_until_they_have_the_rows(logs: Dataset) -> None:
    names = logs.executions["execution"].to_list()
    total = rows_of(logs)
    assert abs(total - logs.samples().height) < 20
    assert some_executions(logs, names, total) == tuple(names)
    half = some_executions(logs, names, total // 2)
    assert 2 <= len(half) <= 3
    assert half == some_executions(logs, names, total // 2)
    assert len(some_executions(logs, names, 1)) == 1


def test_a_part_of_a_dataset_holds_its_executions_alone(logs: Dataset) -> None:
    names = logs.executions["execution"].to_list()
    part = logs.only(names[1:3])
    for frame in (
        part.samples(),
        part.summed_up(lambda samples: samples),
        part.tasks(),
        part.executions,
        part.done_tasks(),
    ):
        assert set(frame["execution"]) == set(names[1:3])
    assert logs.samples(names).equals(logs.samples())


@pytest.mark.parametrize("given", ["many", "999", "-1", "1e6"])
def test_a_memory_that_is_no_number_is_refused(given: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CYCLEKIT_MEMORY_ROWS", given)
    with pytest.raises(ConfigError, match="CYCLEKIT_MEMORY_ROWS"):
        memory_rows()
