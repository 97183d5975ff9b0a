"""`python whole_way.py THREADS LOGS`: everything that is stored or said of a cell, into the folder where it is run.

THREADS is how many numpy and torch take if nobody keeps them from it, also on a machine with fewer cores.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import torch
from threadpoolctl import threadpool_limits

from cyclekit import find_levels
from cyclekit.api.train import Training, train_at
from cyclekit.config.sequences import load_sequences
from cyclekit.dataset.dataset import Dataset
from cyclekit.estimate.plan import load_jobs, plan
from cyclekit.estimate.rollout import estimate
from cyclekit.estimate.validation.check import check_rollout
from cyclekit.ingest.ingest import ingest
from cyclekit.learning.evaluation.evaluate import evaluate
from cyclekit.learning.networks.saved import load_model
from cyclekit.learning.networks.spec import ModelSpec
from cyclekit.learning.safety_function import read_zones

JOBS = 'start = "home"\nvia = "conveyor"\nvisit = ["{}", "{}"]\n'
SPECS = {"now": ModelSpec.of(epochs=2), "ahead": ModelSpec.of("ahead", "regressor", 2.0, epochs=2)}


def main(threads: int, cell: Path) -> None:
    threadpool_limits(threads)
    torch.set_num_threads(threads)
    ingest([cell / "logs"], Path("dataset"))
    dataset = Dataset.open("dataset")
    answers = {}
    for name, spec in SPECS.items():
        train_at(Training("dataset", spec, name))
        answers[f"evaluate_{name}"] = evaluate(load_model(name), dataset, boosting=False).to_dict()
    model, sequences = load_model("now"), load_sequences(cell / "sequences.toml")
    Path("jobs.toml").write_text(JOBS.format(*(sequence.name for sequence in sequences[:2])), encoding="utf-8")
    check = check_rollout(model, dataset)
    answers["estimate"] = [cycle.to_dict() for cycle in estimate(model, dataset, sequences, check=check)]
    answers["zones"] = read_zones(model, dataset).to_dict()
    answers["plan"] = plan(model, dataset, load_jobs(Path("jobs.toml"))).to_dict()
    answers["levels"] = list(find_levels(dataset, method="kmeans-silhouette").levels)
    for name, answer in answers.items():
        Path(f"{name}.json").write_text(json.dumps(answer, indent=2), encoding="utf-8")


if __name__ == "__main__":
    main(int(sys.argv[1]), Path(sys.argv[2]))
