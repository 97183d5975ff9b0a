"""From the logs of a robot that works beside people to the cycle time of task sequences.

    import cyclekit

    cyclekit.ingest_logs("logs", "dataset")
    cyclekit.train_model("dataset", out="model")
    for cycle in cyclekit.estimate_cycles("model", "dataset", "sequences.toml"):
        print(cycle.name, cycle.expected_s, cycle.safety_loss_s)

There is one function for each command, and one place for each default. Names are found here and live in their rooms;
nothing heavy is imported before one is used.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from cyclekit.adapter import Adapter, ReadOptions, Recording
    from cyclekit.api.adapters import list_adapters
    from cyclekit.api.calibrate import calibrate_tracker
    from cyclekit.api.convert import convert_log
    from cyclekit.api.estimate import estimate_cycles
    from cyclekit.api.evaluate import evaluate_model, evaluate_models
    from cyclekit.api.export import export_model
    from cyclekit.api.ingest import ingest_logs
    from cyclekit.api.inspect import draft_cell, inspect_logs
    from cyclekit.api.levels import ScalingLevels, find_levels
    from cyclekit.api.plan import plan_order
    from cyclekit.api.replay import write_replay
    from cyclekit.api.report import write_report
    from cyclekit.api.simulate import simulate_logs
    from cyclekit.api.trace import trace_sample
    from cyclekit.api.train import train_model, train_seeds
    from cyclekit.api.whatif import what_if
    from cyclekit.api.zones import read_safety_function
    from cyclekit.config.sequences import TaskSequence, load_sequences
    from cyclekit.dataset.dataset import Dataset
    from cyclekit.errors import CyclekitError
    from cyclekit.estimate.answers import CycleEstimates
    from cyclekit.estimate.plan.answer import OrderPlan
    from cyclekit.estimate.plan.jobs import Jobs, load_jobs
    from cyclekit.estimate.result import CycleEstimate
    from cyclekit.estimate.whatif.answer import WhatIf
    from cyclekit.estimate.whatif.answers import WhatIfAnswers
    from cyclekit.estimate.whatif.change import Change, load_changes
    from cyclekit.fleet.run import FleetRun, run_fleet
    from cyclekit.ingest.ingest import IngestReport
    from cyclekit.learning.evaluation.evaluate import Evaluation
    from cyclekit.learning.networks.saved import TrainedModel, load_model, save_model
    from cyclekit.learning.networks.spec import ModelSpec
    from cyclekit.learning.safety_function.answer import SafetyFunction
    from cyclekit.parallel.engine import Engine
    from cyclekit.text.results import Result

    __version__: str

_HOMES = {
    "Adapter": "cyclekit.adapter:Adapter",
    "Change": "cyclekit.estimate.whatif.change:Change",
    "CycleEstimate": "cyclekit.estimate.result:CycleEstimate",
    "CycleEstimates": "cyclekit.estimate.answers:CycleEstimates",
    "CyclekitError": "cyclekit.errors:CyclekitError",
    "Dataset": "cyclekit.dataset.dataset:Dataset",
    "Engine": "cyclekit.parallel.engine:Engine",
    "Evaluation": "cyclekit.learning.evaluation.evaluate:Evaluation",
    "FleetRun": "cyclekit.fleet.run:FleetRun",
    "IngestReport": "cyclekit.ingest.ingest:IngestReport",
    "Jobs": "cyclekit.estimate.plan.jobs:Jobs",
    "ModelSpec": "cyclekit.learning.networks.spec:ModelSpec",
    "OrderPlan": "cyclekit.estimate.plan.answer:OrderPlan",
    "ReadOptions": "cyclekit.adapter:ReadOptions",
    "Recording": "cyclekit.adapter:Recording",
    "Result": "cyclekit.text.results:Result",
    "SafetyFunction": "cyclekit.learning.safety_function.answer:SafetyFunction",
    "ScalingLevels": "cyclekit.api.levels:ScalingLevels",
    "TaskSequence": "cyclekit.config.sequences:TaskSequence",
    "TrainedModel": "cyclekit.learning.networks.saved:TrainedModel",
    "WhatIf": "cyclekit.estimate.whatif.answer:WhatIf",
    "WhatIfAnswers": "cyclekit.estimate.whatif.answers:WhatIfAnswers",
    "calibrate_tracker": "cyclekit.api.calibrate:calibrate_tracker",
    "convert_log": "cyclekit.api.convert:convert_log",
    "draft_cell": "cyclekit.api.inspect:draft_cell",
    "estimate_cycles": "cyclekit.api.estimate:estimate_cycles",
    "evaluate_model": "cyclekit.api.evaluate:evaluate_model",
    "evaluate_models": "cyclekit.api.evaluate:evaluate_models",
    "export_model": "cyclekit.api.export:export_model",
    "find_levels": "cyclekit.api.levels:find_levels",
    "ingest_logs": "cyclekit.api.ingest:ingest_logs",
    "inspect_logs": "cyclekit.api.inspect:inspect_logs",
    "list_adapters": "cyclekit.api.adapters:list_adapters",
    "load_changes": "cyclekit.estimate.whatif.change:load_changes",
    "load_jobs": "cyclekit.estimate.plan.jobs:load_jobs",
    "load_model": "cyclekit.learning.networks.saved:load_model",
    "load_sequences": "cyclekit.config.sequences:load_sequences",
    "plan_order": "cyclekit.api.plan:plan_order",
    "read_safety_function": "cyclekit.api.zones:read_safety_function",
    "run_fleet": "cyclekit.fleet.run:run_fleet",
    "save_model": "cyclekit.learning.networks.saved:save_model",
    "simulate_logs": "cyclekit.api.simulate:simulate_logs",
    "trace_sample": "cyclekit.api.trace:trace_sample",
    "train_model": "cyclekit.api.train:train_model",
    "train_seeds": "cyclekit.api.train:train_seeds",
    "what_if": "cyclekit.api.whatif:what_if",
    "write_replay": "cyclekit.api.replay:write_replay",
    "write_report": "cyclekit.api.report:write_report",
}
"""Where each public name lives. A name differs from every module's name, which would shadow it once imported."""

__all__ = [
    "Adapter",
    "Change",
    "CycleEstimate",
    "CycleEstimates",
    "CyclekitError",
    "Dataset",
    "Engine",
    "Evaluation",
    "FleetRun",
    "IngestReport",
    "Jobs",
    "ModelSpec",
    "OrderPlan",
    "ReadOptions",
    "Recording",
    "Result",
    "SafetyFunction",
    "ScalingLevels",
    "TaskSequence",
    "TrainedModel",
    "WhatIf",
    "WhatIfAnswers",
    "__version__",
    "calibrate_tracker",
    "convert_log",
    "draft_cell",
    "estimate_cycles",
    "evaluate_model",
    "evaluate_models",
    "export_model",
    "find_levels",
    "ingest_logs",
    "inspect_logs",
    "list_adapters",
    "load_changes",
    "load_jobs",
    "load_model",
    "load_sequences",
    "plan_order",
    "read_safety_function",
    "run_fleet",
    "save_model",
    "simulate_logs",
    "trace_sample",
    "train_model",
    "train_seeds",
    "what_if",
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
