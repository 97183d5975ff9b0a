"""Learn the speed scaling from a dataset: find the levels, divide the executions, fit the network, judge it.

Executions are divided three ways: most to learn from, some of those to decide which epoch's weights are kept, and a
held-out part that is only looked at once, for the metrics in the model's card. The levels are found in the executions
to learn from alone. How a network is built is in `models.network`; what comes out needs no torch any more.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from msgspec import structs

from cyclekit import schema
from cyclekit.dataset.cards import (
    LevelShare,
    MetricsCard,
    Note,
    RowsCard,
    SplitCard,
    StandardisationCard,
    TrainingCard,
    note,
    texts,
)
from cyclekit.dataset.dataset import Dataset
from cyclekit.dataset.guard import check_output
from cyclekit.dataset.time_grid import samples_in
from cyclekit.dataset.unknown_height import said_of_height
from cyclekit.errors import DatasetError, ModelError, command_line
from cyclekit.extras import need
from cyclekit.learning.coupling.learn import learn_coupling
from cyclekit.learning.labelling import (
    follows_late,
    scaling_in_time,
    staircase_of,
    with_commands,
    without_slider,
)
from cyclekit.learning.networks.beaten import staircase_if_better
from cyclekit.learning.networks.cell import cell_of, fingerprint
from cyclekit.learning.networks.kinds import NETWORKS
from cyclekit.learning.networks.metrics import measure
from cyclekit.learning.networks.saved import MODEL_VERSION, TrainedModel, check_model_output, save_model
from cyclekit.learning.out_of_core import PART_ROWS, frames, in_files, memory_rows, rows_of, some_executions
from cyclekit.learning.rules.of_dataset import law_of, rule_of
from cyclekit.learning.rules.safety import answering
from cyclekit.learning.rules.words import verdict
from cyclekit.learning.signal_inputs import by_signals, learned_rows, mixed
from cyclekit.learning.unseen.fit import learn_unseen
from cyclekit.learning.unseen.saved import save_unseen
from cyclekit.learning.windows import (
    GROUPS,
    Samples,
    build_samples,
    groups_seen_both_ways,
    scaling_without_operator,
    split_executions,
)
from cyclekit.parallel.one_thread import one_thread
from cyclekit.scaling.levels import Staircase, second_opinion
from cyclekit.storage.scratch import Scratch

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    import polars as pl

    from cyclekit.learning.networks.fitted import Fitted
    from cyclekit.learning.networks.spec import ModelSpec
    from cyclekit.schema import Progress


LEAST_S = 10.0
"""Less log than this teaches nothing."""
OF_STAIRCASES = {
    "levels-many",
    "levels-wide",
    "scaling-continuous",
    "levels-not-held",
    "levels-left",
    "levels-disputed",
}
"""Warnings of a staircase that say nothing where the continuous law was found."""
MIN_EXECUTIONS = 3
"""One for training, one for validation, one for the test."""


@one_thread()
def train(dataset: Dataset, spec: ModelSpec, *, rules: bool = False, progress: Progress | None = None) -> TrainedModel:
    """Train the network of `spec` on `dataset` and judge it on held-out executions.

    Of a dataset with more samples than `memory_rows`, the rows to learn from are kept in temporary files and read in
    blocks, so that memory does not grow with them; levels are found in some of the executions.

    Args:
        dataset: With a speed scaling, logged or inferred, and positions of robot and operator.
        spec: What to train.
        rules: Also look for a rule that explains the commanded level; one that does answers in place of the network.
            None is looked for where the network forecasts, or learns the scaling as it was logged on request.
            Where it is the continuous law the network is a regressor.
        progress: Told the fraction done and the validation error after every epoch.

    Returns:
        The model with the weights of its best epoch. Its card holds `metrics` on the held-out executions, the
        `split`, `levels` with their shares, `history`, what was `dropped` and why, and where the data came from.

    Raises:
        DatasetError: The dataset lacks what training needs; the message says what.
        MissingExtra: torch is not installed.
    """
    dataset.require_positions()
    need_torch(spec)
    rules = rules and spec.problem == "now" and spec.target != "logged"
    if rules and spec.kind.needs_levels and law_of(dataset, seed=spec.seed) is not None:
        spec = replace(spec, network="regressor", hidden=NETWORKS["regressor"].hidden, target="logged")
    if by_signals(dataset) and spec.features == "auto":  # there is no distance
        spec = replace(spec, features="positions")
    spec = spec.at_rate(dataset.rate_hz).with_features()
    with Scratch() as scratch:
        if rows_of(dataset) <= memory_rows():
            found = _in_memory(dataset, spec)
        else:
            found = _in_parts(dataset, spec, scratch.path, memory_rows())
        _check_learnable(dataset, found.learn, found.check, found.held_out, spec)
        spec = replace(spec, target="commanded" if _commanded(dataset, spec, found.staircase) else "logged")
        fitted = _fit(spec)(spec, found.learn, found.check, found.levels, progress, known=found.known)
        made = (spec.problem, spec.network, spec.horizon_s, found.levels, fitted.weights)
        model = TrainedModel(*made, history=spec.history or (1, 1), past=spec.features == "past")
        signals = by_signals(dataset)
        better = None if signals else staircase_if_better(model, fitted.spec, found.learn, found.held_out)
        beaten = [note("model-beaten", text=better.said(dataset.place, "MODEL"))] if better else []
        card = _card(dataset, found, fitted, measure(model, found.held_out), beaten)
        card = structs.replace(card, coupling=learn_coupling(dataset))
    model = replace(model, card=card)
    return with_rule(model, dataset, seed=spec.seed) if rules and len(model.levels) > 1 else model


def with_rule(model: TrainedModel, dataset: Dataset, *, seed: int = 0) -> TrainedModel:
    """Return the model with the simplest rule that explains the commanded level beside it, or a warning why none is.

    The rule is fitted to the executions that the network learned from, and judged by those held out.

    Raises:
        ModelError: The model does not predict which level holds now.
    """
    if model.problem != "now":
        msg = f"a rule gives the present scaling, and the model is for problem {model.problem!r}"
        raise ModelError(msg, cure="Give a model of --problem now.")
    found = rule_of(dataset, model.levels, model=model, judged_apart=True, signals=False, seed=seed)
    if found.rule is not None and answering(replace(model, card=structs.replace(model.card, rule=found.rule))) is model:
        found = replace(found, rule=None)
    said = () if found.rule is not None else (note("model-data", text=f"{verdict(found)}; the network answers"),)
    warned = model.card.warnings
    if found.rule is not None and found.rule.law is not None:
        warned = tuple(one for one in warned if one.code not in OF_STAIRCASES)
    card = structs.replace(model.card, rule=found.rule, warnings=(*warned, *said))
    return replace(model, card=card)


@dataclass(frozen=True)
class _Rows:
    """What a model learns from and is judged by.

    Attributes:
        seen: Samples of executions to learn from (some of them, where there are very many), for levels and the like.
        notes: What was done to them.
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


def _builder(dataset: Dataset, spec: ModelSpec) -> Callable[..., Samples]:
    rate_hz, history = dataset.rate_hz, spec.history or (1, 1)
    past, horizon_s = spec.features == "past", spec.horizon_s
    return partial(
        build_samples, problem=spec.problem, horizon_s=horizon_s, rate_hz=rate_hz, history=history, past=past
    )


def _fit(spec: ModelSpec) -> Callable[..., Fitted]:
    """Return what trains it; imported here, so that this module needs no torch, and trees need none at all."""
    if spec.kind.trees:
        from cyclekit.learning.networks.boosting import fit_trees

        return fit_trees
    from cyclekit.learning.networks.fitting import fit

    return fit


def _in_memory(dataset: Dataset, spec: ModelSpec) -> _Rows:
    frame = learned_rows(dataset, dataset.samples(dataset.executions["execution"].to_list()))
    frame, slider = without_slider(dataset, frame)
    build = _builder(dataset, spec)
    everything = build(frame, levels=(), allow=GROUPS)
    enough = samples_in(LEAST_S / 2, dataset.rate_hz)
    either = groups_seen_both_ways(everything, enough)
    usable = _enough(dataset, frame, build(frame, levels=(), allow=either))
    split = _split(dataset, [usable.executions[i] for i in np.unique(usable.execution)], spec)
    seen = frame.filter(frame["execution"].is_in([*split.train, *split.validation]))
    staircase = _staircase(dataset, seen, spec)
    levels = _rounded(staircase)
    known = groups_seen_both_ways(everything.of(split.train), enough)
    if _commanded(dataset, spec, staircase):
        frame = with_commands(dataset, frame, levels)
    rows = _enough(dataset, frame, build(frame, levels=levels, allow=known))
    learn, check, held_out = (rows.of(part) for part in (split.train, split.validation, split.test))
    notes = (slider,) if slider else ()
    return _Rows(learn, check, held_out, split, staircase, levels, known, seen, notes, rows.dropped)


def _in_parts(dataset: Dataset, spec: ModelSpec, folder: Path, most_rows: int) -> _Rows:
    """Do as `_in_memory` for more samples than memory takes: rows to learn from stay in files of `folder`.

    Levels and what may be unknown are found in as many executions as memory takes. Of those held out there are no more
    than that either: a tenth of it already tells an error to a hundredth of itself.
    """
    most = most_rows / 10 / rows_of(dataset)
    parts = (min(spec.test_fraction, most), min(spec.validation_fraction, most))
    smaller = replace(spec, test_fraction=parts[0], validation_fraction=parts[1])
    split = _split(dataset, dataset.executions["execution"].to_list(), smaller)
    some = some_executions(dataset, [*split.train, *split.validation], most_rows // 2, seed=spec.seed)
    seen, slider = without_slider(dataset, learned_rows(dataset, dataset.samples(some)))
    build = _builder(dataset, spec)
    known = groups_seen_both_ways(build(seen, levels=(), allow=GROUPS), samples_in(LEAST_S / 2, dataset.rate_hz))
    staircase = _staircase(dataset, seen, spec)
    levels = _rounded(staircase)
    _enough(dataset, seen, build(seen, levels=levels, allow=known))

    def built(frame: pl.DataFrame) -> Samples:
        frame = learned_rows(dataset, frame)
        frame = without_slider(dataset, frame)[0] if slider else frame
        frame = with_commands(dataset, frame, levels) if _commanded(dataset, spec, staircase) else frame
        return build(frame, levels=levels, allow=known)

    def rows(frame: pl.DataFrame) -> Samples:
        found = built(frame)
        on_level = found.where(found.step >= 0) if spec.kind.names_levels else found
        return replace(on_level, dropped=found.dropped)

    learn = in_files((rows(frame) for frame in frames(dataset, split.train, min(PART_ROWS, most_rows))), folder)
    check, held_out = (built(dataset.samples(part)) for part in (split.validation, split.test))
    dropped = sum((Counter(part.dropped) for part in (learn, check, held_out)), Counter[str]())
    notes = (*((slider,) if slider else ()), note("learned-in-files", executions=len(some)))
    return _Rows(learn, check, held_out, split, staircase, levels, known, seen, notes, dict(dropped))


def _commanded(dataset: Dataset, spec: ModelSpec, staircase: Staircase) -> bool:
    """Return whether the network learns the commanded levels: where the scaling has levels and follows them late."""
    if spec.problem != "now" or spec.target == "logged" or not staircase.is_staircase:
        return False
    return len(staircase.levels) > 1 and follows_late(dataset.card.dynamics)


def _rounded(staircase: Staircase) -> tuple[float, ...]:
    return tuple(round(float(level), 6) for level in staircase.levels)


def _card(dataset: Dataset, found: _Rows, fitted: Fitted, metrics: MetricsCard, beaten: list[Note]) -> TrainingCard:
    shares = zip(found.levels, found.staircase.share, strict=True)
    spec = fitted.spec
    alone = with_commands(dataset, found.seen, found.levels) if spec.target == "commanded" else found.seen
    warnings = [
        *found.notes,
        *mixed(dataset),
        *(note("model-data", text=text) for text in said_of_height(found.seen)),
        *found.staircase.warnings,
        *_other_opinion(dataset, found.seen, found.staircase),
        *beaten,
    ]
    return TrainingCard(
        cyclekit=version("cyclekit"),
        schema_version=schema.SCHEMA_VERSION,
        model_version=MODEL_VERSION,
        spec=spec.card(),
        problem=spec.problem,
        network=spec.network,
        horizon_s=spec.horizon_s,
        seed=spec.seed,
        dataset=dataset.path.name,
        dataset_sha256=fingerprint(dataset),
        cell=cell_of(dataset),
        metrics=metrics,
        levels=tuple(LevelShare(value=value, share=round(float(share), 6)) for value, share in shares),
        warnings=tuple(warnings),
        rate_hz=dataset.rate_hz,
        temperature=fitted.temperature,
        may_be_unknown=tuple(found.known),
        scaling_without_operator=scaling_without_operator(alone),
        mean_scaling=float(found.learn.scaling.mean()),
        rows=RowsCard(train=len(found.learn), validation=len(found.check), test=len(found.held_out)),
        dropped=dict(found.dropped),
        inputs=tuple(found.learn.inputs),
        standardisation=StandardisationCard(mean_m=tuple(fitted.mean.tolist()), scale_1_m=tuple(fitted.scale.tolist())),
        split=found.split,
        history=fitted.history,
        operator_signals=dataset.card.operator_signals if by_signals(dataset) else (),
    )


@dataclass(frozen=True)
class Training:
    """One model to train, as a task of an engine: the places of dataset and model, what to train, and if with rules."""

    dataset: str
    spec: ModelSpec
    out: str
    rules: bool = False


def train_at(what: Training, *, progress: Progress | None = None) -> TrainingCard:
    """Train a model and put it in its place; return its card. Of a robot's log alone it is one of an unseen operator.

    Raises:
        OutputError: The model would replace what is no model, or lie in the dataset.
        CyclekitError: As `train`, or the model cannot be written.
    """
    check_output(what.out, "model", [what.dataset])
    check_model_output(what.out)
    dataset = Dataset.open(what.dataset)
    if learns_unseen(dataset, what.spec):
        unseen = learn_unseen(dataset, seed=what.spec.seed, progress=progress)
        save_unseen(what.out, unseen)
        return unseen.card
    model = train(dataset, what.spec, rules=what.rules, progress=progress)
    save_model(what.out, model)
    return model.card


def learns_unseen(dataset: Dataset, spec: ModelSpec) -> bool:
    """Tell whether the present scaling is learned from a robot's log alone: no tracker and no signal shows people."""
    if spec.problem != "now" or dataset.card.operator_signals or not dataset.positions:
        return False
    return bool(dataset.samples(columns=["human_x_m"])["human_x_m"].is_null().all())


def need_torch(spec: ModelSpec | None = None) -> None:
    """Refuse to begin what ends in a training that cannot be; trees need no torch.

    Raises:
        MissingExtra: torch is not installed.
    """
    if spec is None or not spec.kind.trees:
        need("training", "train")


def _enough(dataset: Dataset, frame: pl.DataFrame, rows: Samples) -> Samples:
    """Return the rows, or refuse if they are too few to learn from."""
    if frame["scaling"].is_null().all():
        cure = "Log the scaling, or give a reference run without the operator in cell.toml so that it can be inferred."
        msg = f"{dataset.path}: the speed scaling is unknown in all {frame.height} samples, so nothing can be learned"
        raise DatasetError(msg, cure=cure)
    if len(rows) < (least := samples_in(LEAST_S, dataset.rate_hz)):
        why = "; ".join(f"{reason}: {count}" for reason, count in rows.dropped.items()) or "the log is that short"
        msg = f"{dataset.path}: only {len(rows)} of {frame.height} samples can be learned from ({why})"
        look = command_line("inspect", dataset.place)
        raise DatasetError(msg, cure=f"At least {least} are needed, {LEAST_S:g} s. See what the logs lack: {look}")
    return rows


def _check_learnable(dataset: Dataset, learn: Samples, check: Samples, held_out: Samples, spec: ModelSpec) -> None:
    """Refuse when the split leaves too little to learn from: executions may be of very different length."""
    seen = (learn.step >= 0) & np.isfinite(learn.X[:, GROUPS["human"]].sum(axis=1))  # nobody there teaches no zone
    count = int(seen.sum()) if spec.kind.names_levels else len(learn)
    if count < samples_in(LEAST_S / 2, dataset.rate_hz):
        what = "samples on a level beside an operator" if spec.kind.names_levels else "usable samples"
        msg = f"{dataset.path}: the training executions have only {count} {what}"
        raise DatasetError(msg, cure="Log more executions, or let another --seed choose which are held out.")
    for rows, purpose in ((check, "for validation"), (held_out, "for the test")):
        if not len(rows):
            msg = f"{dataset.path}: the executions {purpose} have no usable sample"
            raise DatasetError(msg, cure="Log more executions, or let another --seed choose which are held out.")


def _other_opinion(dataset: Dataset, frame: pl.DataFrame, staircase: Staircase) -> list[Note]:
    scaling, _ = scaling_in_time(frame, dataset.rate_hz)
    other = second_opinion(scaling, staircase)
    return [] if other is None else [other]


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
    """Find the levels; a network that names steps needs at least two of them."""
    scaling, _ = scaling_in_time(frame, dataset.rate_hz)
    staircase = staircase_of(dataset, frame)
    if np.nanmax(scaling) - np.nanmin(scaling) < 1e-6:
        msg = f"{dataset.path}: the speed scaling is {np.nanmax(scaling):.2f} everywhere, so there is nothing to learn"
        raise DatasetError(msg, cure="Log executions in which the operator is near enough to slow the robot.")
    if spec.kind.needs_levels and (staircase.levels.size < 2 or not staircase.is_staircase):
        msg = f"{dataset.path}: a {spec.network} needs at least two levels, but {'; '.join(texts(staircase.warnings))}"
        raise DatasetError(msg, cure="Train a network that needs none: --network regressor")
    return staircase
