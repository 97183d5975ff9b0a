"""Cycle times of task sequences from the logs of human-robot cells.

    import cyclekit

    cyclekit.ingest_logs("logs", "dataset")
    cyclekit.train_model("dataset", out="model")
    for cycle in cyclekit.estimate_cycles("model", "dataset", "sequences.toml"):
        print(cycle.name, cycle.expected_s, cycle.safety_loss_s)

There is one function for each command, and one place for each default. Public names are imported from their modules
when first used, so that importing the package is fast.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from cyclekit.adapter import Adapter as Adapter
    from cyclekit.adapter import ReadOptions as ReadOptions
    from cyclekit.adapter import Recording as Recording
    from cyclekit.api.adapters import list_adapters as list_adapters
    from cyclekit.api.calibrate import calibrate_tracker as calibrate_tracker
    from cyclekit.api.convert import convert_log as convert_log
    from cyclekit.api.estimate import estimate_cycles as estimate_cycles
    from cyclekit.api.evaluate import evaluate_model as evaluate_model
    from cyclekit.api.evaluate import evaluate_models as evaluate_models
    from cyclekit.api.evaluate import evaluate_task_times as evaluate_task_times
    from cyclekit.api.export import export_model as export_model
    from cyclekit.api.gate import gate_takt as gate_takt
    from cyclekit.api.ingest import ingest_logs as ingest_logs
    from cyclekit.api.init import start_project as start_project
    from cyclekit.api.inspect import LoggedHistory as LoggedHistory
    from cyclekit.api.inspect import draft_cell as draft_cell
    from cyclekit.api.inspect import inspect_logs as inspect_logs
    from cyclekit.api.inspect import logged_history as logged_history
    from cyclekit.api.inspect import plan_recordings as plan_recordings
    from cyclekit.api.levels import ScalingLevels as ScalingLevels
    from cyclekit.api.levels import find_levels as find_levels
    from cyclekit.api.plan import plan_order as plan_order
    from cyclekit.api.replay import write_replay as write_replay
    from cyclekit.api.report import write_report as write_report
    from cyclekit.api.simulate import simulate_logs as simulate_logs
    from cyclekit.api.trace import trace_sample as trace_sample
    from cyclekit.api.train import train_model as train_model
    from cyclekit.api.train import train_seeds as train_seeds
    from cyclekit.api.train import train_task_times as train_task_times
    from cyclekit.api.whatif import what_if as what_if
    from cyclekit.api.zones import cost_of_safety_function as cost_of_safety_function
    from cyclekit.api.zones import read_safety_function as read_safety_function
    from cyclekit.config.sequences import TaskSequence as TaskSequence
    from cyclekit.config.sequences import load_sequences as load_sequences
    from cyclekit.dataset.dataset import Dataset as Dataset
    from cyclekit.errors import CyclekitError as CyclekitError
    from cyclekit.estimate.answers import CycleEstimates as CycleEstimates
    from cyclekit.estimate.plan.answer import OrderPlan as OrderPlan
    from cyclekit.estimate.plan.jobs import Jobs as Jobs
    from cyclekit.estimate.plan.jobs import load_jobs as load_jobs
    from cyclekit.estimate.plan.task_orders import JobTask as JobTask
    from cyclekit.estimate.plan.task_orders import TaskJobs as TaskJobs
    from cyclekit.estimate.plan.task_orders import TaskOrderPlan as TaskOrderPlan
    from cyclekit.estimate.result import CycleEstimate as CycleEstimate
    from cyclekit.estimate.whatif.answer import WhatIf as WhatIf
    from cyclekit.estimate.whatif.answers import WhatIfAnswers as WhatIfAnswers
    from cyclekit.estimate.whatif.change import Change as Change
    from cyclekit.estimate.whatif.change import LimitChange as LimitChange
    from cyclekit.estimate.whatif.change import load_changes as load_changes
    from cyclekit.estimate.whatif.costs import SafetyCosts as SafetyCosts
    from cyclekit.estimate.whatif.separation import Separation as Separation
    from cyclekit.fleet.project import run_project as run_project
    from cyclekit.fleet.run import FleetRun as FleetRun
    from cyclekit.fleet.run import run_fleet as run_fleet
    from cyclekit.ingest.report import IngestReport as IngestReport
    from cyclekit.learning.evaluation.evaluate import Evaluation as Evaluation
    from cyclekit.learning.networks.saved import TrainedModel as TrainedModel
    from cyclekit.learning.networks.saved import load_model as load_model
    from cyclekit.learning.networks.saved import save_model as save_model
    from cyclekit.learning.networks.spec import ModelSpec as ModelSpec
    from cyclekit.learning.safety_function.answer import SafetyFunction as SafetyFunction
    from cyclekit.parallel.engine import Engine as Engine
    from cyclekit.text.results import Result as Result

    __version__: str

_NAMES = {
    "adapter": "Adapter ReadOptions Recording",
    "api.adapters": "list_adapters",
    "api.calibrate": "calibrate_tracker",
    "api.convert": "convert_log",
    "api.estimate": "estimate_cycles",
    "api.evaluate": "evaluate_model evaluate_models evaluate_task_times",
    "api.export": "export_model",
    "api.gate": "gate_takt",
    "api.ingest": "ingest_logs",
    "api.inspect": "LoggedHistory draft_cell inspect_logs logged_history plan_recordings",
    "api.levels": "ScalingLevels find_levels",
    "api.plan": "plan_order",
    "api.init": "start_project",
    "api.replay": "write_replay",
    "api.report": "write_report",
    "api.simulate": "simulate_logs",
    "api.trace": "trace_sample",
    "api.train": "train_model train_seeds train_task_times",
    "api.whatif": "what_if",
    "api.zones": "cost_of_safety_function read_safety_function",
    "config.sequences": "TaskSequence load_sequences",
    "dataset.dataset": "Dataset",
    "errors": "CyclekitError",
    "estimate.answers": "CycleEstimates",
    "estimate.plan.answer": "OrderPlan",
    "estimate.plan.task_orders": "JobTask TaskJobs TaskOrderPlan",
    "estimate.plan.jobs": "Jobs load_jobs",
    "estimate.result": "CycleEstimate",
    "estimate.whatif.answer": "WhatIf",
    "estimate.whatif.answers": "WhatIfAnswers",
    "estimate.whatif.change": "Change LimitChange load_changes",
    "estimate.whatif.costs": "SafetyCosts",
    "estimate.whatif.separation": "Separation",
    "fleet.project": "run_project",
    "fleet.run": "FleetRun run_fleet",
    "ingest.report": "IngestReport",
    "learning.evaluation.evaluate": "Evaluation",
    "learning.networks.saved": "TrainedModel load_model save_model",
    "learning.networks.spec": "ModelSpec",
    "learning.safety_function.answer": "SafetyFunction",
    "parallel.engine": "Engine",
    "text.results": "Result",
}
"""Public names by module. No name equals that of a module, which would shadow it once imported."""
_HOMES = {name: f"cyclekit.{module}:{name}" for module, names in _NAMES.items() for name in names.split()}
__all__ = sorted([*_HOMES, "__version__"])

if not TYPE_CHECKING:  # type checkers use the imports above, which finds misspelt names

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
    return __all__
