"""Trains a model on a dataset: find the levels, split the executions, fit the network, evaluate it.

`divided_rows` splits the executions, `networks` builds a network; the result needs no torch.
"""

from __future__ import annotations

from dataclasses import replace
from importlib.metadata import version
from typing import TYPE_CHECKING

from msgspec import structs

from cyclekit import schema
from cyclekit.dataset.cards import LevelShare, MetricsCard, Note, RowsCard, StandardisationCard, TrainingCard, note
from cyclekit.dataset.dataset import Dataset
from cyclekit.dataset.unknown_height import height_notes
from cyclekit.errors import ModelError, NoLevels
from cyclekit.extras import need
from cyclekit.learning.coupling.learn import learn_coupling
from cyclekit.learning.divided_rows import DividedRows, divided, is_commanded
from cyclekit.learning.labelling import notes_of_logs, scaling_in_time, with_commands
from cyclekit.learning.networks.cell import cell_of, fingerprint
from cyclekit.learning.networks.comparison import staircase_if_better
from cyclekit.learning.networks.kinds import NETWORKS
from cyclekit.learning.networks.metrics import measure
from cyclekit.learning.networks.saved import MODEL_VERSION, TrainedModel
from cyclekit.learning.rules.of_dataset import law_of, rule_of
from cyclekit.learning.rules.safety import predictor_of
from cyclekit.learning.rules.words import verdict
from cyclekit.learning.signal_inputs import by_signals, mixed
from cyclekit.learning.windows import scaling_without_operator
from cyclekit.parallel.one_thread import one_thread
from cyclekit.scaling.levels import Staircase, second_opinion
from cyclekit.storage.scratch import Scratch

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    import polars as pl

    from cyclekit.dataset.cards.rule import RuleCard
    from cyclekit.learning.networks.fitted import Fitted
    from cyclekit.learning.networks.spec import ModelSpec
    from cyclekit.schema import Progress

OF_STAIRCASES = {
    "levels-many",
    "levels-wide",
    "scaling-continuous",
    "levels-not-held",
    "levels-left",
    "levels-disputed",
}
"""Warnings on levels that do not apply to a continuous law."""
NETWORK_SHARE, SIGNALS_SHARE = 0.8, 0.9
"""Measured share of a training's time until the network is fitted, before the search for a rule: with positions, and
with signals alone. Only the progress told rests on it: half of what is left makes the last stage seem half as long."""


@one_thread()
def train(dataset: Dataset, spec: ModelSpec, *, rules: bool = False, progress: Progress | None = None) -> TrainedModel:
    """Train the network of `spec` on `dataset` and evaluate it on held-out executions.

    If the dataset has more samples than `memory_rows`, training rows are kept in temporary files and read in blocks,
    and levels are found in a subset of the executions.

    Args:
        dataset: Dataset with a speed scaling, logged or inferred, and positions of robot and operator.
        spec: What to train.
        rules: Also search a rule that explains the commanded level; if one is found, it replaces the network. Not for a
            network that forecasts, or that learns the logged scaling on request. For the continuous law, and for any
            other scaling without levels, the network is a regressor.
        progress: Called after every epoch with the share done and the validation error.

    Returns:
        The model with the weights of its best epoch. Its card holds `metrics` on the held-out executions, the `split`,
        `levels` with their shares, `history`, `dropped` rows by reason, and the origin of the data.

    Raises:
        DatasetError: The dataset lacks what training needs; the message names it.
        MissingExtra: torch is not installed.
    """
    dataset.require_positions()
    need_torch(spec)
    rules = rules and spec.problem == "now" and spec.target != "logged"
    share = 1.0 if not rules else SIGNALS_SHARE if by_signals(dataset) else NETWORK_SHARE

    def told(fraction: float, text: str) -> None:
        if progress is not None:
            progress(share * fraction, text)

    if rules and spec.kind.needs_levels and law_of(dataset, seed=spec.seed) is not None:
        spec = _without_levels(spec)
    if by_signals(dataset) and spec.features == "auto":  # without positions there is no distance
        spec = replace(spec, features="positions")
    spec = spec.at_rate(dataset.rate_hz).with_features()
    with Scratch() as scratch:
        try:
            found = divided(dataset, spec, scratch.path)
        except NoLevels:
            if not rules:
                raise
            spec = _without_levels(spec)
            found = divided(dataset, spec, scratch.path)
        spec = replace(spec, target="commanded" if is_commanded(dataset, spec, found.staircase) else "logged")
        fitted = _fit(spec)(spec, found.learn, found.check, found.levels, told, known=found.known)
        made = (spec.problem, spec.network, spec.horizon_s, found.levels, fitted.weights)
        model = TrainedModel(*made, history=spec.history or (1, 1), past=spec.features == "past")
        signals = by_signals(dataset)
        better = None if signals else staircase_if_better(model, fitted.spec, found.learn, found.held_out)
        rival_notes = [note("model-beaten", text=better.said(dataset.place, "MODEL"))] if better else []
        card = _card(dataset, found, fitted, measure(model, found.held_out), rival_notes)
        card = structs.replace(card, coupling=learn_coupling(dataset))
    model = replace(model, card=card)
    stairs = found.staircase.is_staircase and len(model.levels) > 1
    if rules:
        model = with_rule(model, dataset, seed=spec.seed, stairs=stairs)
        told(1.0 / share, "done")
    return model


def _without_levels(spec: ModelSpec) -> ModelSpec:
    """Return the settings with a network that needs no levels."""
    return replace(spec, network="regressor", hidden=NETWORKS["regressor"].hidden, target="logged")


def warnings_with_rule(warnings: Iterable[Note], rule: RuleCard) -> tuple[Note, ...]:
    """Return the warnings of a network that still matter where a rule answers in its place."""
    needless = {"model-beaten"} if rule.law is None else {"model-beaten", *OF_STAIRCASES}
    return tuple(one for one in warnings if one.code not in needless)


def with_rule(model: TrainedModel, dataset: Dataset, *, seed: int = 0, stairs: bool = True) -> TrainedModel:
    """Return the model with the simplest rule that explains the commanded level, or with a warning if there is none.

    The rule is fitted to the training executions of the network and evaluated on the held-out ones.

    Args:
        model: Network of problem `now`.
        dataset: Dataset of its training.
        seed: Seed of random draws.
        stairs: Whether the scaling has levels. If not, only the continuous law is tried: a rule on values that are no
            levels would be right wherever nobody is near, and so in nearly all samples.

    Raises:
        ModelError: The model does not predict the present scaling.
    """
    if model.problem != "now":
        msg = f"a rule gives the present scaling, and the model is for problem {model.problem!r}"
        raise ModelError(msg, cure="Give a model of --problem now.")
    levels = model.levels if stairs else ()
    found = rule_of(dataset, levels, model=model, keep_held_out=True, signals=False, seed=seed)
    if (
        found.rule is not None
        and predictor_of(replace(model, card=structs.replace(model.card, rule=found.rule))) is model
    ):
        found = replace(found, rule=None)
    why = verdict(found) if stairs else "the scaling has no levels, and follows no law of one distance"
    said = () if found.rule is not None else (note("model-data", text=f"{why}; the network answers"),)
    warned = model.card.warnings if found.rule is None else warnings_with_rule(model.card.warnings, found.rule)
    card = structs.replace(model.card, rule=found.rule, warnings=(*warned, *said))
    return replace(model, card=card)


def _fit(spec: ModelSpec) -> Callable[..., Fitted]:
    """Return the training function; imported when needed, because trees need no torch."""
    if spec.kind.trees:
        from cyclekit.learning.networks.boosting import fit_trees

        return fit_trees
    from cyclekit.learning.networks.fitting import fit

    return fit


def _card(
    dataset: Dataset, found: DividedRows, fitted: Fitted, metrics: MetricsCard, rival_notes: list[Note]
) -> TrainingCard:
    shares = zip(found.levels, found.staircase.share, strict=True)
    spec = fitted.spec
    alone = with_commands(dataset, found.seen, found.levels) if spec.target == "commanded" else found.seen
    warnings = [
        *found.notes,
        *mixed(dataset),
        *notes_of_logs(dataset),
        *(note("model-data", text=text) for text in height_notes(found.seen)),
        *found.staircase.warnings,
        *_other_opinion(dataset, found.seen, found.staircase),
        *rival_notes,
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


def learns_unseen(dataset: Dataset, spec: ModelSpec) -> bool:
    """Return whether the present scaling is learned from a robot's log alone, as no tracker or signal shows people."""
    if spec.problem != "now" or dataset.card.operator_signals or not dataset.positions:
        return False
    return bool(dataset.samples(columns=["human_x_m"])["human_x_m"].is_null().all())


def need_torch(spec: ModelSpec | None = None) -> None:
    """Refuse a training that needs torch if it is not installed; trees do not need it.

    Raises:
        MissingExtra: torch is not installed.
    """
    if spec is None or not spec.kind.trees:
        need("training", "train")


def _other_opinion(dataset: Dataset, frame: pl.DataFrame, staircase: Staircase) -> list[Note]:
    scaling, _ = scaling_in_time(frame, dataset.rate_hz)
    other = second_opinion(scaling, staircase)
    return [] if other is None else [other]
