"""Learns an unseen operator from a robot's log alone: levels, regions of the robot, states.

With enough executions two models are compared on held-out executions: levels independent of the robot's position, with
each level as a state; and hidden states whose levels depend on the region of the robot. The second one is chosen if it
explains the held-out levels better by more than chance.
"""

from __future__ import annotations

from dataclasses import dataclass
from importlib.metadata import version
from typing import TYPE_CHECKING

import numpy as np

from cyclekit import schema
from cyclekit.dataset.cards import LevelShare, RowsCard, SplitCard, TrainingCard, note
from cyclekit.dataset.cards.unseen import UnseenOperatorCard
from cyclekit.errors import DatasetError, command_line
from cyclekit.learning.coupling.learn import learn_coupling
from cyclekit.learning.labelling import notes_of_logs
from cyclekit.learning.networks.cell import cell_of, fingerprint
from cyclekit.learning.networks.saved import MODEL_VERSION
from cyclekit.learning.unseen.hidden import fit, log_likelihoods, of_levels
from cyclekit.learning.unseen.model import UnseenOperator, courses_of, nearest, side_by_side
from cyclekit.parallel.one_thread import one_thread
from cyclekit.text.numbers import fixed

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cyclekit.dataset.dataset import Dataset
    from cyclekit.learning.unseen.model import Course
    from cyclekit.schema import Ints, Points, Progress

STEP_S = 0.2
"""Time step of the chain, s."""
REGIONS = 16
"""Number of regions of the TCP."""
ROUNDS = 20
"""Number of k-means iterations for the centres of the regions."""
STATES = (6, 8, 12)
"""Numbers of hidden states tried."""
MIN_COMPARED = 12
"""Minimum number of executions at which a model with regions is tried."""
HELD_OUT = 0.25
"""Share of the executions held out for the comparison."""
BEYOND = 2.0
"""Minimum advantage of the model with regions, in standard errors."""
MAX_COMPARED = 80
"""Maximum number of executions in the comparison."""
MIN_EXECUTIONS = 3
"""Minimum number of executions."""


@one_thread()
def learn_unseen(dataset: Dataset, *, seed: int = 0, progress: Progress | None = None) -> UnseenOperator:
    """Learn the effect of people whom no log shows from the speed scaling.

    Args:
        dataset: Dataset of a robot's log with its speed scaling.
        seed: Seed of the held-out executions and of the random starts of the fit.
        progress: Called with share done and text.

    Raises:
        DatasetError: The scaling is unknown or constant, or there are fewer than MIN_EXECUTIONS executions.
    """
    tell = progress or (lambda _fraction, _text: None)
    levels, courses = _usable(dataset)
    every = max(1, round(STEP_S * dataset.rate_hz))
    some = list(courses.values())
    centres = centres_of(np.concatenate([one.robot_m[::every] for one in some]), REGIONS)
    found = _chosen(some, centres, len(levels), every, seed, tell)
    seen = side_by_side(some, found.centres, every)
    chain = fit(seen, found.states, len(found.centres), len(levels), seed=seed) if found.states else of_levels(
        seen, len(levels)
    )  # fmt: skip
    step_s = every / dataset.rate_hz
    card = UnseenOperatorCard(
        step_s=step_s,
        regions_m=tuple((float(x), float(y), float(z)) for x, y, z in found.centres.round(4)),
        start=tuple(chain.start.tolist()),
        follows=tuple(tuple(row) for row in chain.follows.tolist()),
        shares=tuple(tuple(tuple(cell) for cell in row) for row in chain.levels.tolist()),
        seen_s=tuple(tuple(row) for row in (chain.steps * step_s).tolist()),
        with_place=found.with_place,
        without_place=found.without_place,
        executions=len(some),
    )
    tell(1.0, "done")
    return UnseenOperator(levels, card, _card(dataset, levels, courses, seed))


def _usable(dataset: Dataset) -> tuple[tuple[float, ...], dict[str, Course]]:
    """Return the levels, and the courses of executions that are no references without people, and not interrupted."""
    levels, courses = courses_of(dataset)
    other = {one.execution for one in dataset.card.executions if one.reference or one.interrupted_s}
    courses = {name: one for name, one in courses.items() if name not in other and (one.level >= 0).any()}
    if len(levels) < 2:
        msg = f"{dataset.path}: the speed scaling is {fixed(levels[0] if levels else 1.0, 2)} everywhere"
        raise DatasetError(msg, cure="Log executions in which the operator is near enough to slow the robot.")
    if len(courses) < MIN_EXECUTIONS:
        msg = f"{dataset.path}: {len(courses)} usable execution(s); at least {MIN_EXECUTIONS} are needed"
        raise DatasetError(msg, cure=f"See what the logs lack: {command_line('inspect', dataset.place)}")
    return levels, courses


@dataclass(frozen=True)
class _Choice:
    """Regions, number of hidden states (0 = the levels themselves), and log-likelihood of both models per minute."""

    centres: Points
    states: int
    with_place: float | None = None
    without_place: float | None = None


def _chosen(courses: Sequence[Course], centres: Points, levels: int, every: int, seed: int, tell: Progress) -> _Choice:
    """Return the model that explains held-out executions best; with regions only if significantly better."""
    anywhere = _Choice(centres[:1], 0)
    if len(courses) < MIN_COMPARED:
        return anywhere
    drawn = np.random.default_rng(seed).permutation(len(courses))[:MAX_COMPARED]
    seen = side_by_side([courses[i] for i in drawn], centres, every)
    count = round(HELD_OUT * len(drawn))
    judged, learned = seen.of(np.arange(count)), seen.of(np.arange(count, len(drawn)))
    minutes = float((judged.level >= 0).sum()) * STEP_S / 60.0
    plain = log_likelihoods(judged, of_levels(learned, levels))
    best, states = plain, 0
    for number, some in enumerate(STATES):
        tell(number / (len(STATES) + 1), f"{some} states of an unseen operator")
        mine = log_likelihoods(judged, fit(learned, some, len(centres), levels, seed=seed))
        if mine.sum() > best.sum():
            best, states = mine, some
    gain = best - plain
    if not states or gain.mean() < BEYOND * gain.std(ddof=1) / np.sqrt(count):
        return _Choice(centres[:1], 0, float(best.sum()) / minutes, float(plain.sum()) / minutes)
    return _Choice(centres, states, float(best.sum()) / minutes, float(plain.sum()) / minutes)


def centres_of(xyz_m: Points, count: int) -> Points:
    """Return the centres of regions of positions (N, 3): k-means from starting points far apart."""
    centres = xyz_m[:1]
    away = ((xyz_m - centres[0]) ** 2).sum(axis=1)
    while len(centres) < count and away.max() > 0.0:
        centres = np.vstack([centres, xyz_m[away.argmax()]])
        away = np.minimum(away, ((xyz_m - centres[-1]) ** 2).sum(axis=1))
    for _ in range(ROUNDS):
        centres = _moved(xyz_m, nearest(xyz_m, centres), centres)
    return centres


def _moved(xyz_m: Points, mine: Ints, centres: Points) -> Points:
    count = np.bincount(mine, minlength=len(centres))
    sums = np.column_stack([np.bincount(mine, xyz_m[:, axis], minlength=len(centres)) for axis in range(3)])
    return np.where(count[:, None] > 0, sums / np.maximum(count, 1)[:, None], centres)


def _why_unseen(dataset: Dataset) -> str:
    """Return why the positions of the operator are unknown: no log shows people, or none while a robot log runs."""
    logs = [one for one in dataset.recordings if "people" in one.tables]
    if not logs:
        return "no log shows people: the positions of the operator are unknown"
    clocks = [said.text for one in logs for said in one.clock.warnings]
    cause = "; ".join(clocks) or "its clock, or the part of the cell that it covers, differs"
    return f"{logs[0].shown} shows people, but nobody while a robot log runs: {cause}"


def _card(dataset: Dataset, levels: tuple[float, ...], courses: dict[str, Course], seed: int) -> TrainingCard:
    every = np.concatenate([one.level for one in courses.values()])
    known = every[every >= 0]
    share = np.bincount(known, minlength=len(levels)) / max(len(known), 1)
    shares = zip(levels, share.tolist(), strict=True)
    return TrainingCard(
        cyclekit=version("cyclekit"),
        schema_version=schema.SCHEMA_VERSION,
        model_version=MODEL_VERSION,
        problem="now",
        network="unseen operator",
        horizon_s=0.0,
        seed=seed,
        dataset=dataset.path.name,
        dataset_sha256=fingerprint(dataset),
        cell=cell_of(dataset),
        levels=tuple(LevelShare(value=value, share=round(part, 6)) for value, part in shares),
        warnings=(
            *notes_of_logs(dataset),
            note("model-data", text=_why_unseen(dataset)),
        ),
        rate_hz=dataset.rate_hz,
        mean_scaling=float(np.array(levels)[known].mean()),
        rows=RowsCard(train=len(known), validation=0, test=0),
        split=SplitCard(train=tuple(courses)),
        coupling=learn_coupling(dataset),
    )
