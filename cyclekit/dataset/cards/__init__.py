"""The cards: everything that cyclekit keeps as JSON beside its tables, as typed values with units and limits.

In goes the text of `dataset.json`, `model.json`, a kept recording or `cell.json`; out comes a frozen card, or one
sentence that says which value is wrong and what was expected. A card may come from anywhere, so whoever opens one
checks it here before any of it is used. Keys that are not known are passed over: another version may have written them.
What the values are used for is the business of the rooms above; this one knows none of them.
"""

from cyclekit.dataset.cards.dataset import (
    DatasetCard,
    DynamicsCard,
    ExecutionCard,
    FileCard,
    PlaceCard,
    RowCounts,
    UnreadCard,
    dataset_card,
)
from cyclekit.dataset.cards.fleet import CellLedger, FiguresCard, StageCard
from cyclekit.dataset.cards.model import (
    CellCard,
    EpochCard,
    LevelShare,
    MetricsCard,
    ModelCard,
    RowsCard,
    SpecCard,
    SplitCard,
    StandardisationCard,
    TrainingCard,
    model_card,
)
from cyclekit.dataset.cards.notes import READ, TEXT, Note, note, texts
from cyclekit.dataset.cards.read import BadCard, checked, parse_json, plain, read_content, read_json
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

__all__ = [
    "READ",
    "TEXT",
    "BadCard",
    "CellCard",
    "CellLedger",
    "ClockCard",
    "ClockMethod",
    "DatasetCard",
    "DynamicsCard",
    "EpochCard",
    "ExecutionCard",
    "FiguresCard",
    "FileCard",
    "FrameCard",
    "LevelShare",
    "LogCard",
    "MetricsCard",
    "ModelCard",
    "Note",
    "OperatorCard",
    "PlaceCard",
    "RecordingCard",
    "RowCounts",
    "RowsCard",
    "SetAside",
    "SourceFile",
    "SpecCard",
    "SplitCard",
    "StageCard",
    "StandardisationCard",
    "TrainingCard",
    "UnreadCard",
    "checked",
    "dataset_card",
    "model_card",
    "note",
    "parse_json",
    "plain",
    "read_content",
    "read_json",
    "texts",
]
