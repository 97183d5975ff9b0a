"""Training, validation and test rows, with the levels found in the first two.

Executions are split three ways: most for training, some of these to select the best epoch, and a held-out part that is
used only once, for the metrics in the model's card.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from cyclekit.dataset.cards import Note, SplitCard, note, texts
from cyclekit.dataset.time_grid import samples_in
from cyclekit.errors import DatasetError, NoLevels, command_line
from cyclekit.learning.labelling import (
    follows_late,
    need_scaling,
    scaling_in_time,
    staircase_of,
    with_commands,
    without_slider,
)
from cyclekit.learning.out_of_core import PART_ROWS, frames, in_files, memory_rows, rows_of, some_executions
from cyclekit.learning.signal_inputs import learned_rows
from cyclekit.learning.windows import GROUPS, Samples, build_samples, groups_seen_both_ways, split_executions
from cyclekit.text.numbers import fixed, given

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence
    from pathlib import Path

    import polars as pl

    from cyclekit.dataset.dataset import Dataset
    from cyclekit.learning.networks.spec import ModelSpec
    from cyclekit.scaling.levels import Staircase

MIN_S = 10.0
"""Minimum duration of usable log, s."""
MIN_EXECUTIONS = 3
"""Minimum number of executions: one each for training, validation and test."""


@dataclass(frozen=True)
class DividedRows:
    """Training, validation and test rows of a model.

    Attributes:
        seen: Samples of executions to learn from (a subset if there are very many), for levels and similar.
        notes: Notes on how the samples were processed.
    """

    learn: Samples
    check: Samples
    held_out: Samples
    split: SplitCard
    staircase: Staircase
    levels: tuple[float, ...]
    known: tuple[str, ...]
    seen: pl.DataFrame
    notes: tuple[Note, ...]
    dropped: Mapping[str, int]


def divided(dataset: Dataset, spec: ModelSpec, folder: Path) -> DividedRows:
    """Return the training, validation and test rows; if they exceed memory, training rows are in files of `folder`.

    Raises:
        DatasetError: There are too few rows, or nothing to learn; the message gives the reason.
        NoLevels: The network needs levels, and the scaling has none.
    """
    most_rows = memory_rows()
    small = rows_of(dataset) <= most_rows
    found = _in_memory(dataset, spec) if small else _in_parts(dataset, spec, folder, most_rows)
    _check_learnable(dataset, found, spec)
    return found


def _builder(dataset: Dataset, spec: ModelSpec) -> Callable[..., Samples]:
    rate_hz, history = dataset.rate_hz, spec.history or (1, 1)
    past, horizon_s = spec.features == "past", spec.horizon_s
    return partial(
        build_samples, problem=spec.problem, horizon_s=horizon_s, rate_hz=rate_hz, history=history, past=past
    )


def _in_memory(dataset: Dataset, spec: ModelSpec) -> DividedRows:
    frame = learned_rows(dataset, dataset.samples(dataset.executions["execution"].to_list()))
    frame, slider = without_slider(dataset, frame)
    build = _builder(dataset, spec)
    everything = build(frame, levels=(), allow=GROUPS)
    enough = samples_in(MIN_S / 2, dataset.rate_hz)
    either = groups_seen_both_ways(everything, enough)
    usable = _enough(dataset, frame, build(frame, levels=(), allow=either))
    split = _split(dataset, [usable.executions[i] for i in np.unique(usable.execution)], spec)
    seen = frame.filter(frame["execution"].is_in([*split.train, *split.validation]))
    staircase = _staircase(dataset, seen, spec)
    levels = _rounded(staircase)
    known = groups_seen_both_ways(everything.of(split.train), enough)
    if is_commanded(dataset, spec, staircase):
        frame = with_commands(dataset, frame, levels)
    rows = _enough(dataset, frame, build(frame, levels=levels, allow=known))
    learn, check, held_out = (rows.of(part) for part in (split.train, split.validation, split.test))
    notes = (slider,) if slider else ()
    return DividedRows(learn, check, held_out, split, staircase, levels, known, seen, notes, rows.dropped)


def _in_parts(dataset: Dataset, spec: ModelSpec, folder: Path, most_rows: int) -> DividedRows:
    """Return rows as `_in_memory` does, for more samples than fit in memory; training rows are in files of `folder`.

    Levels and groups that may be unknown are found in as many executions as fit in memory. Held-out executions are
    limited to a tenth of that, which already determines an error to 1 %.
    """
    most = most_rows / 10 / rows_of(dataset)
    parts = (min(spec.test_fraction, most), min(spec.validation_fraction, most))
    smaller = replace(spec, test_fraction=parts[0], validation_fraction=parts[1])
    split = _split(dataset, dataset.executions["execution"].to_list(), smaller)
    some = some_executions(dataset, [*split.train, *split.validation], most_rows // 2, seed=spec.seed)
    seen, slider = without_slider(dataset, learned_rows(dataset, dataset.samples(some)))
    build = _builder(dataset, spec)
    known = groups_seen_both_ways(build(seen, levels=(), allow=GROUPS), samples_in(MIN_S / 2, dataset.rate_hz))
    staircase = _staircase(dataset, seen, spec)
    levels = _rounded(staircase)
    _enough(dataset, seen, build(seen, levels=levels, allow=known))

    def built(frame: pl.DataFrame) -> Samples:
        frame = learned_rows(dataset, frame)
        frame = without_slider(dataset, frame)[0] if slider else frame
        frame = with_commands(dataset, frame, levels) if is_commanded(dataset, spec, staircase) else frame
        return build(frame, levels=levels, allow=known)

    def rows(frame: pl.DataFrame) -> Samples:
        found = built(frame)
        on_level = found.where(found.step >= 0) if spec.kind.is_classifier else found
        return replace(on_level, dropped=found.dropped)

    learn = in_files((rows(frame) for frame in frames(dataset, split.train, min(PART_ROWS, most_rows))), folder)
    check, held_out = (built(dataset.samples(part)) for part in (split.validation, split.test))
    dropped = sum((Counter(part.dropped) for part in (learn, check, held_out)), Counter[str]())
    notes = (*((slider,) if slider else ()), note("learned-in-files", executions=len(some)))
    return DividedRows(learn, check, held_out, split, staircase, levels, known, seen, notes, dict(dropped))


def is_commanded(dataset: Dataset, spec: ModelSpec, staircase: Staircase) -> bool:
    """Return whether the network learns commanded levels: if the scaling has levels and follows them with a delay."""
    if spec.problem != "now" or spec.target == "logged" or not staircase.is_staircase:
        return False
    return len(staircase.levels) > 1 and follows_late(dataset.card.dynamics)


def _rounded(staircase: Staircase) -> tuple[float, ...]:
    return tuple(round(float(level), 6) for level in staircase.levels)


def _enough(dataset: Dataset, frame: pl.DataFrame, rows: Samples) -> Samples:
    """Return the rows, or refuse if there are too few."""
    need_scaling(dataset, frame)
    if len(rows) < (least := samples_in(MIN_S, dataset.rate_hz)):
        why = "; ".join(f"{reason}: {count}" for reason, count in rows.dropped.items()) or "the log is that short"
        msg = f"{dataset.path}: only {len(rows)} of {frame.height} samples can be learned from ({why})"
        look = command_line("inspect", dataset.place)
        raise DatasetError(msg, cure=f"At least {least} are needed, {given(MIN_S)} s. See what the logs lack: {look}")
    return rows


def _check_learnable(dataset: Dataset, found: DividedRows, spec: ModelSpec) -> None:
    """Refuse a split with too few training rows, because executions may differ in length."""
    learn = found.learn
    seen = (learn.step >= 0) & np.isfinite(learn.X[:, GROUPS["human"]].sum(axis=1))  # needed to learn zones
    count = int(seen.sum()) if spec.kind.is_classifier else len(learn)
    if count < samples_in(MIN_S / 2, dataset.rate_hz):
        what = "samples on a level with an operator seen" if spec.kind.is_classifier else "usable samples"
        msg = f"{dataset.path}: the training executions have only {count} {what}"
        error = NoLevels if spec.kind.is_classifier else DatasetError
        raise error(msg, cure="Log more executions, or let another --seed choose which are held out.")
    for rows, purpose in ((found.check, "for validation"), (found.held_out, "for the test")):
        if not len(rows):
            msg = f"{dataset.path}: the executions {purpose} have no usable sample"
            raise DatasetError(msg, cure="Log more executions, or let another --seed choose which are held out.")


def _split(dataset: Dataset, names: Sequence[str], spec: ModelSpec) -> SplitCard:
    if len(names) < MIN_EXECUTIONS:
        msg = f"{dataset.path}: {len(names)} usable execution(s); at least {MIN_EXECUTIONS} are needed"
        cure = "One for training, one for validation, one for the test: log more, or set in cell.toml how they begin."
        raise DatasetError(msg, cure=cure)
    learn, test = split_executions(names, test_fraction=spec.test_fraction, seed=spec.seed)
    if len(learn) < 2:
        learn, test = (*learn, *test[1:]), test[:1]
    fit, validation = split_executions(learn, test_fraction=spec.validation_fraction, seed=spec.seed)
    return SplitCard(train=tuple(fit), validation=tuple(validation), test=tuple(test))


def _staircase(dataset: Dataset, frame: pl.DataFrame, spec: ModelSpec) -> Staircase:
    """Return the staircase; a network that predicts levels needs at least two."""
    scaling, _ = scaling_in_time(frame, dataset.rate_hz)
    staircase = staircase_of(dataset, frame)
    if np.nanmax(scaling) - np.nanmin(scaling) < 1e-6:
        msg = (
            f"{dataset.path}: the speed scaling is {fixed(np.nanmax(scaling), 2)} everywhere, so there is "
            "nothing to learn"
        )
        raise DatasetError(msg, cure="Log executions in which the operator is near enough to slow the robot.")
    if spec.kind.needs_levels and (staircase.levels.size < 2 or not staircase.is_staircase):
        msg = f"{dataset.path}: a {spec.network} needs at least two levels, but {'; '.join(texts(staircase.warnings))}"
        raise NoLevels(msg, cure="Train a network that needs none: --network regressor")
    return staircase
