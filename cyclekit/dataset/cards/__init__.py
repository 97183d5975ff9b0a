"""The cards: everything that cyclekit keeps as JSON beside its tables, as typed values with units and limits.

In goes the text of `dataset.json`, `model.json`, a kept recording or `cell.json`; out comes a frozen card, or one
sentence that says which value is wrong and what was expected. A card may come from anywhere, so whoever opens one
checks it here before any of it is used. Keys that are not known are passed over: another version may have written them.
What the values are used for is the business of the rooms above; this one knows none of them.
"""

from cyclekit.dataset.cards.dataset import DatasetCard, DynamicsCard, ExecutionCard, PlaceCard, RowCounts, UnreadCard
from cyclekit.dataset.cards.fleet import CellLedger, FiguresCard, StageCard
from cyclekit.dataset.cards.model import CellCard, MetricsCard, ModelCard, SpecCard, SplitCard, TrainingCard
from cyclekit.dataset.cards.read import BadCard, checked, parse_json, read_content, read_json
from cyclekit.dataset.cards.recording import (
    ClockCard,
    ClockMethod,
    FrameCard,
    LogCard,
    OperatorCard,
    RecordingCard,
    SetAside,
    SourceFile,
)
from cyclekit.dataset.cards.settings import CellSettings

__all__ = [
    "BadCard",
    "CellCard",
    "CellLedger",
    "CellSettings",
    "ClockCard",
    "ClockMethod",
    "DatasetCard",
    "DynamicsCard",
    "ExecutionCard",
    "FiguresCard",
    "FrameCard",
    "LogCard",
    "MetricsCard",
    "ModelCard",
    "OperatorCard",
    "PlaceCard",
    "RecordingCard",
    "RowCounts",
    "SetAside",
    "SourceFile",
    "SpecCard",
    "SplitCard",
    "StageCard",
    "TrainingCard",
    "UnreadCard",
    "checked",
    "parse_json",
    "read_content",
    "read_json",
]
