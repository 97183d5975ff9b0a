"""From the logs of a robot that works beside people to the cycle time of task sequences.

    from cyclekit import ingest_logs, Dataset, ModelSpec, train_model, load_sequences, estimate_cycles

    ingest_logs([Path("logs")], Path("dataset"))
    dataset = Dataset.open("dataset")
    model = train_model(dataset, ModelSpec.of())
    for cycle in estimate_cycles(model, dataset, load_sequences(Path("sequences.toml"))):
        print(cycle.name, cycle.expected_s, cycle.safety_loss_s)

The public names are found here and live in their rooms; nothing heavy is imported before a name is used.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from cyclekit.adapter import Adapter, ReadOptions, Recording
    from cyclekit.config.sequences import TaskSequence, load_sequences
    from cyclekit.dataset.dataset import Dataset
    from cyclekit.errors import CyclekitError
    from cyclekit.estimate.result import CycleEstimate
    from cyclekit.estimate.rollout import estimate as estimate_cycles
    from cyclekit.ingest.ingest import ingest as ingest_logs
    from cyclekit.inspect.describe import describe as describe_path
    from cyclekit.learning.evaluation.evaluate import evaluate as evaluate_model
    from cyclekit.learning.networks.saved import load_model, save_model
    from cyclekit.learning.networks.spec import ModelSpec
    from cyclekit.learning.training import train as train_model
    from cyclekit.parallel.engine import Engine
    from cyclekit.replay import write_replay
    from cyclekit.report import write_report

    __version__: str

_HOMES = {
    "Adapter": "cyclekit.adapter:Adapter",
    "CycleEstimate": "cyclekit.estimate.result:CycleEstimate",
    "CyclekitError": "cyclekit.errors:CyclekitError",
    "Dataset": "cyclekit.dataset.dataset:Dataset",
    "Engine": "cyclekit.parallel.engine:Engine",
    "ModelSpec": "cyclekit.learning.networks.spec:ModelSpec",
    "ReadOptions": "cyclekit.adapter:ReadOptions",
    "Recording": "cyclekit.adapter:Recording",
    "TaskSequence": "cyclekit.config.sequences:TaskSequence",
    "describe_path": "cyclekit.inspect.describe:describe",
    "estimate_cycles": "cyclekit.estimate.rollout:estimate",
    "evaluate_model": "cyclekit.learning.evaluation.evaluate:evaluate",
    "ingest_logs": "cyclekit.ingest.ingest:ingest",
    "load_model": "cyclekit.learning.networks.saved:load_model",
    "load_sequences": "cyclekit.config.sequences:load_sequences",
    "save_model": "cyclekit.learning.networks.saved:save_model",
    "train_model": "cyclekit.learning.training:train",
    "write_replay": "cyclekit.replay:write_replay",
    "write_report": "cyclekit.report:write_report",
}
"""Where each public name lives. A name differs from every module's name, which would shadow it once imported."""

__all__ = [
    "Adapter",
    "CycleEstimate",
    "CyclekitError",
    "Dataset",
    "Engine",
    "ModelSpec",
    "ReadOptions",
    "Recording",
    "TaskSequence",
    "__version__",
    "describe_path",
    "estimate_cycles",
    "evaluate_model",
    "ingest_logs",
    "load_model",
    "load_sequences",
    "save_model",
    "train_model",
    "write_replay",
    "write_report",
]

if not TYPE_CHECKING:  # the type checker reads the imports above, so that a slip in a name is found

    def __getattr__(name: str) -> object:
        """Import a public name when it is first used."""
        if name == "__version__":
            from importlib.metadata import version

            return version("cyclekit")
        if name not in _HOMES:
            msg = f"module 'cyclekit' has no attribute {name!r}"
            raise AttributeError(msg)
        module, _, attribute = _HOMES[name].partition(":")
        return getattr(import_module(module), attribute)


def __dir__() -> list[str]:
    return sorted(__all__)
