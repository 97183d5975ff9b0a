"""`model.json`: the shape of a network, and the card of its training."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Literal

from msgspec import Meta, field

from cyclekit.dataset.cards.coupling import CouplingCard
from cyclekit.dataset.cards.dataset import OperatorSignalCard
from cyclekit.dataset.cards.notes import Note, from_sentences, texts
from cyclekit.dataset.cards.quantities import (
    Card,
    Count,
    Digest,
    Fraction,
    Hertz,
    Length,
    Measure,
    Metres,
    Positive,
    Scaling,
    Work,
    ascending,
)
from cyclekit.dataset.cards.read import checked, plain
from cyclekit.dataset.cards.rule import RuleCard

Width = Annotated[int, Meta(ge=1, le=4096)]
"""Number of inputs or outputs of a layer."""
Layer = tuple[Width, Width]
"""Inputs and outputs of a layer."""
Deviation = Annotated[float, Meta(ge=-1e15, le=1e15)]
"""Mean error of estimated scalings, or mean of squared errors."""
Samples = Annotated[int, Meta(ge=1, le=1000)]
"""Number of samples in the input of a network, or of rows between two of them."""


class SplitCard(Card, frozen=True, kw_only=True):
    """Names of the executions used for training, for choosing the epoch, and for evaluation."""

    train: tuple[str, ...] = ()
    validation: tuple[str, ...] = ()
    test: tuple[str, ...] = ()


class MetricsCard(Card, frozen=True, kw_only=True):
    """Errors on held-out executions.

    Attributes:
        rows: Number of samples evaluated.
        mse_mean: Mean squared error of the best estimate.
        mse_argmax: Mean squared error of the most probable level; None without levels.
        mae: Mean absolute error of the best estimate.
        bias: Mean of predicted - true.
        accuracy: Share of the samples with the correct level; None without levels.
        calibration_error: Calibration error of a classifier's probabilities; None for other networks.
        mse_constant: Mean squared error of always predicting the mean of these samples; None = not measured.
    """

    rows: Count
    mse_mean: Deviation
    mse_argmax: Deviation | None = None
    mae: Deviation
    bias: Deviation
    accuracy: Fraction | None = None
    calibration_error: Fraction | None = None
    mse_constant: Deviation | None = None


class LevelShare(Card, frozen=True, kw_only=True):
    """A level of the speed scaling, and the share of samples at it."""

    value: Scaling
    share: Fraction


class EpochCard(Card, frozen=True, kw_only=True):
    """One pass over the training samples: mean loss, and error on the validation samples."""

    epoch: Count
    loss: Measure
    validation_mse: Measure


class StandardisationCard(Card, frozen=True, kw_only=True):
    """Mean of each input, m, and the factor on deviations from it, 1/m."""

    mean_m: tuple[Measure, ...]
    scale_1_m: tuple[Measure, ...]


class RowsCard(Card, frozen=True, kw_only=True):
    """Numbers of samples used for training, for choosing the epoch, and for evaluation."""

    train: Count
    validation: Count
    test: Count


class SpecCard(Card, frozen=True, kw_only=True):
    """Training settings; see `cyclekit.learning.networks.spec.ModelSpec`."""

    problem: str
    network: str
    horizon_s: Work
    hidden: tuple[Positive, ...] = ()
    norm: str = "batch"
    seed: Count = 0
    epochs: Positive | None = None
    batch: Positive = 1024
    learning_rate: Measure = 6e-3
    test_fraction: Fraction = 0.2
    validation_fraction: Fraction = 0.1
    freeze_norm_after: Fraction | None = None
    weight_decay: Measure | None = None
    patience: Positive | None = None
    noise_m: Length = 0.0
    optimiser: str = "auto"
    features: str = "positions"
    target: str = "logged"
    balance: str = "none"
    history: tuple[Samples, Samples] = (1, 1)
    forecast_weight: Measure = 0.02
    centre: bool = True


class CellCard(Card, frozen=True, kw_only=True):
    """The cell that a model was trained on; see `cyclekit.learning.networks.cell.cell_of`.

    Attributes:
        name: Name of the cell.
        places: By name: x, y, z and radius, m, and whether it was found in the logs.
        levels: Levels of the speed scaling, ascending.
        logs: Pose of each log's frame, by checksum of the log: x, y, z, m, and the rotation by rows; None = unknown.
    """

    name: str = ""
    places: dict[str, tuple[Metres, Metres, Metres, Length, bool]] = field(default_factory=dict)
    levels: tuple[Scaling, ...] = ()
    logs: dict[str, Annotated[tuple[Metres, ...], Meta(min_length=12, max_length=12)] | None] = field(
        default_factory=dict
    )


class TrainingCard(Card, frozen=True, kw_only=True):
    """How a model was trained. Values may be missing (None).

    Attributes:
        cyclekit: Version that trained it.
        cell: The cell it was trained on.
        dataset, dataset_sha256: Name of the dataset, and the fingerprint of its card.
        metrics: Errors on held-out executions.
        levels: Levels, with their shares in the training executions.
        temperature: Divisor of a classifier's outputs.
        may_be_unknown: Groups of inputs that may be unknown.
        scaling_without_operator: The scaling without an operator; None also if the logs never show it.
        mean_scaling: Mean scaling of the training samples.
        dropped: Number of unusable samples, by reason.
        inputs: Names of the inputs.
        warnings: Limits of the model that a user must know.
        rule: The rule used instead of the network; None = the network is used.
        coupling: Wait conditions of robot and operator; None = not searched.
        operator_signals: Signals it was trained on instead of the operator's position, in the order of the bits of
            `human_signals`; empty if the position was known.
    """

    cyclekit: str | None = None
    schema_version: Count | None = None
    model_version: Count | None = None
    spec: SpecCard | None = None
    problem: str | None = None
    network: str | None = None
    horizon_s: Work | None = None
    seed: Count | None = None
    dataset: str | None = None
    dataset_sha256: str | None = None
    cell: CellCard | None = None
    metrics: MetricsCard | None = None
    levels: tuple[LevelShare, ...] | None = None
    warnings: tuple[Note, ...] = ()
    rate_hz: Hertz | None = None
    temperature: Annotated[float, Meta(ge=1e-6, le=1e6)] | None = None
    may_be_unknown: tuple[str, ...] = ()
    scaling_without_operator: Scaling | None = None
    mean_scaling: Scaling | None = None
    rows: RowsCard | None = None
    dropped: dict[str, Count] = field(default_factory=dict)
    inputs: tuple[str, ...] | None = None
    standardisation: StandardisationCard | None = None
    split: SplitCard | None = None
    history: tuple[EpochCard, ...] | None = None
    rule: RuleCard | None = None
    coupling: CouplingCard | None = None
    operator_signals: tuple[OperatorSignalCard, ...] = ()

    @property
    def held_out(self) -> tuple[str, ...]:
        """Names of the executions used for evaluation; empty if unknown."""
        return self.split.test if self.split is not None else ()

    def to_dict(self) -> dict[str, object]:
        """Return JSON values for display: with sentences instead of the codes of warnings."""
        return {**plain(self, nulls=True), "warnings": texts(self.warnings)}


class ModelCard(Card, frozen=True, kw_only=True):
    """A model. `cyclekit.learning.networks.tensors` checks that its parts fit each other.

    Attributes:
        problem, network: What it predicts, and its architecture.
        horizon_s: Horizon of the target; 0 for problem `now`.
        levels: Levels of the speed scaling, ascending; empty for a network without levels.
        history: Number of samples in the input, and rows between them.
        past: Whether the input also has the time since the goals changed, and the past scaling.
        layers: Feed-forward layers, in order; empty for trees.
        trees: Number of trees, and of nodes in each; None without trees.
        recurrent: LSTM layers: inputs and width.
        forecast: Layer that forecasts the operator's position; None without one.
        known: Groups of inputs that may be unknown.
        distance: Mean distance of operator and TCP, m, if it is an input; else None.
        weights_sha256: Checksum of the weights file.
        card: How the model was trained.
    """

    format: Literal["cyclekit-model"]
    model_version: Count
    schema_version: Count
    problem: str
    network: str
    horizon_s: Annotated[float, Meta(ge=0.0, le=1e6)]
    levels: Annotated[tuple[Scaling, ...], Meta(max_length=64)]
    history: tuple[Samples, Samples]
    past: bool = False
    layers: Annotated[tuple[Layer, ...], Meta(max_length=32)]
    trees: Layer | None = None
    recurrent: Annotated[tuple[Layer, ...], Meta(max_length=32)] = ()
    forecast: Layer | None = None
    known: tuple[str, ...]
    distance: Annotated[float, Meta(ge=0.0, le=1e6)] | None = None
    weights_sha256: Digest
    card: TrainingCard

    def __post_init__(self) -> None:
        """Refuse levels that are not ascending.

        Raises:
            ValueError: They are not ascending.
        """
        ascending(self.levels)


def model_card(values: Mapping[str, object]) -> ModelCard:
    """Return JSON values as the card of a model; warnings may be sentences, as in earlier versions.

    Raises:
        BadCard: A value is missing or invalid.
    """
    if isinstance(card := values.get("card"), dict) and "warnings" in card:
        values = {**values, "card": {**card, "warnings": from_sentences(card["warnings"])}}
    return checked(values, ModelCard)
