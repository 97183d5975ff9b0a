"""The two main calls of the simulator: plant logs with ground truth, and fresh executions of one sequence.

Logs are written into a temporary folder next to `out` and moved there at the end, so a killed simulation leaves nothing
that looks like logs. The same seed gives the same bytes.
"""

from __future__ import annotations

import dataclasses
import errno
import json
import shutil
from collections.abc import Callable, Sequence
from pathlib import Path

import msgspec
import numpy as np
import polars as pl

from cyclekit_sim.cell_file import cell_file
from cyclekit_sim.choices import ENCODER, LOGGED, SEQUENCE, TRACKER, draw_places, stream
from cyclekit_sim.coupled import CoupledWork, coupled_work
from cyclekit_sim.coupled_list import listed_conditions, task_list
from cyclekit_sim.coupled_scenes import COUPLED
from cyclekit_sim.coupled_truth import conditions, coupled_executions, coupled_tasks
from cyclekit_sim.encoder import measured
from cyclekit_sim.errors import SimulationError
from cyclekit_sim.fields import NAMES, rule_of
from cyclekit_sim.motion import Place
from cyclekit_sim.options import SimulationOptions
from cyclekit_sim.plan import Work, prepare, process_times, run_alone, run_sessions
from cyclekit_sim.scenes import BUILT_IN, Scene
from cyclekit_sim.session import Session
from cyclekit_sim.tracker import record
from cyclekit_sim.truth import execution_table, sample_table, task_rows, task_table
from cyclekit_sim.write_bag import BAG_EPOCH_S, write_bag
from cyclekit_sim.write_csv import UPTIME_S, write_events, write_people, write_plc, write_robot
from cyclekit_sim.write_plc import write_trace

Progress = Callable[[float, str], None]
_DEFAULT = SimulationOptions()
_TRUTH = ("executions", "tasks", "samples")


def scene_places(scene: str) -> dict[str, Place]:
    """Return the robot places of a scene: name -> TCP position, m, base frame."""
    return dict(_scene(scene).places)


def random_sequence(scene: str, seed: int) -> list[str]:
    """Return place names in visiting order as the scene's robot would draw them, home first and last."""
    cell = _scene(scene)
    return list(draw_places(cell, stream(seed, cell, SEQUENCE, 0)))


def simulate(
    scene: str,
    out: Path,
    *,
    executions: int,
    seed: int,
    options: SimulationOptions = _DEFAULT,
    progress: Progress | None = None,
) -> Path:
    """Simulate a cell and write its logs, its cell file and its ground truth into the folder `out`.

    Args:
        scene: One of SCENES, FIELD_SCENES or COUPLED.
        out: Folder to create. An earlier simulation there is replaced; any other content is refused.
        executions: Number of executions.
        seed: The same seed gives the same bytes; execution i does not depend on the number of executions.
        options: Log format, imperfections, dynamics.
        progress: Called with the fraction done and a description.

    Returns:
        `out`.

    Raises:
        SimulationError: Unknown scene, unusable options, a folder with other content, or a robot that gets stuck.
        OSError: The folder cannot be written; its previous content remains.
    """
    work = _prepare(scene, seed, options, executions)
    _refuse_foreign(out)
    partial, retired = (out.with_name(f".{out.name}.{kind}") for kind in ("partial", "retired"))
    if retired.exists() and not out.exists():  # killed between the two renames below
        retired.replace(out)
    shutil.rmtree(partial, ignore_errors=True)
    try:
        _write(partial, work, progress or (lambda _done, _what: None))
        shutil.rmtree(retired, ignore_errors=True)
        if out.exists():
            out.replace(retired)
        partial.replace(out)
        shutil.rmtree(retired, ignore_errors=True)
    except pl.exceptions.PolarsError as error:  # error of polars for a full disk
        raise OSError(errno.EIO, str(error).rpartition("error: ")[2], str(out)) from error
    finally:
        shutil.rmtree(partial, ignore_errors=True)
    return out


def simulate_sequence(
    scene: str,
    places: Sequence[str],
    *,
    executions: int,
    seed: int,
    options: SimulationOptions = _DEFAULT,
    logged: bool = False,
) -> pl.DataFrame:
    """Run one place sequence repeatedly with a fresh operator each time, without writing logs.

    The random streams are independent of those of `simulate` for all seeds; if `logged`, execution *i* has the operator
    of logged execution *i* of that seed, as far as the scene is not recorded in one piece.

    Returns:
        One row per execution: execution, duration_s, nominal_s, safety_loss_s, dwell_s, wait_s.

    Raises:
        SimulationError: Unknown scene or place, or a robot that gets stuck.
    """
    cell, options = set_up(scene, options)
    work = prepare(cell, seed, options, executions=executions, places=places)
    work = dataclasses.replace(work, domain=LOGGED) if logged else work
    rows = [row for trace in run_alone(work, work.executions) for row in task_rows(trace, 0.0)]
    sums = ("nominal_s", "safety_loss_s", "dwell_s", "wait_s")
    return (
        pl.DataFrame(rows)
        .group_by("execution", maintain_order=True)
        .agg((pl.col("end_s").last() - pl.col("start_s").first()).alias("duration_s"), pl.col(sums).sum())
    )


def _scene(name: str) -> Scene:
    if name not in BUILT_IN:
        raise SimulationError(f"no scene {name!r}: choose one of {', '.join((*BUILT_IN, *COUPLED))}")
    return BUILT_IN[name]


def set_up(name: str, options: SimulationOptions) -> tuple[Scene, SimulationOptions]:
    """Return the scene with the safety function of the options, and the options completed from the scene."""
    scene = _scene(name)
    people = options.people or ("tracker" if scene.tracked else "signals")
    if people in ("signals", "both"):
        if not scene.fields:
            raise SimulationError(f"{name} has no fields, so it cannot log their signals: use people = 'tracker'")
        scene = dataclasses.replace(scene, safety=rule_of(scene.fields), plc=scene.plc or options.plc_trace is not None)
    elif options.plc_trace:
        raise SimulationError(f"{name}: plc_trace needs signals of fields: use people = 'signals' or 'both'")
    if options.rule is not None:
        scene = dataclasses.replace(scene, safety=options.rule)
    return scene, dataclasses.replace(
        options,
        people=people,
        latency_s=options.latency_s or scene.latency_s,
        ramp_down_per_s=options.ramp_down_per_s or scene.ramp_down_per_s,
        ramp_up_per_s=options.ramp_up_per_s or scene.ramp_up_per_s,
    )


def _prepare(scene: str, seed: int, options: SimulationOptions, executions: int) -> Work | CoupledWork:
    if scene in COUPLED:
        if options.people not in (None, "tracker", "none") or options.plc_trace:
            seen = f"{scene} has no fields, so it cannot log their signals"
            raise SimulationError(f"{seen}: use people = 'tracker' or 'none'")
        return coupled_work(scene, seed, dataclasses.replace(options, people=options.people or "tracker"), executions)
    if options.coupling != 1.0 or not options.signals or options.task_list:
        raise SimulationError(f"{scene}: coupling, signals and task lists are only for {', '.join(COUPLED)}")
    cell, options = set_up(scene, options)
    return prepare(cell, seed, options, executions=executions)


def _refuse_foreign(out: Path) -> None:
    if not out.exists():
        return
    if not out.is_dir() or (any(out.iterdir()) and not (out / "truth" / "truth.json").is_file()):
        raise SimulationError(f"{out} exists and is not an earlier simulation: choose another folder")


def _write(folder: Path, work: Work | CoupledWork, progress: Progress) -> None:
    (folder / "truth").mkdir(parents=True)
    clock_s = BAG_EPOCH_S if work.options.logs == "mcap" else UPTIME_S
    tables: dict[str, list[pl.DataFrame]] = {name: [] for name in _TRUTH}
    lists: list[pl.DataFrame] = []
    total = len(work.executions)

    def in_motion(share: float) -> None:
        progress(share, "cell in motion")

    sessions = work.sessions(in_motion) if isinstance(work, CoupledWork) else run_sessions(work, in_motion)
    for session in sessions:
        tasks, executions = _tables(session, work, clock_s)
        last = int(tasks["execution"][-1])
        progress((last + 1) / total, f"writing {session.name}, execution {last + 1} of {total}")
        if isinstance(work, CoupledWork) and work.options.task_list:
            lists.append(task_list(session, work.cell))
        else:
            _write_session(folder / session.name, session, work)
        tables["tasks"].append(tasks)
        tables["executions"].append(executions)
        tables["samples"].append(sample_table(session, work.scene, clock_s))
    for name, parts in tables.items():
        pl.concat(parts).write_parquet(folder / "truth" / f"{name}.parquet")
    (folder / "truth" / "truth.json").write_text(_facts(work), encoding="utf-8")
    if lists:
        pl.concat(lists).write_csv(folder / "tasks.csv", float_precision=3)
    (folder / "cell.toml").write_text(cell_file(work.scene, work.options, *_signal_logs(work)), encoding="utf-8")
    progress(1.0, "done")


def _tables(session: Session, work: Work | CoupledWork, clock_s: float) -> tuple[pl.DataFrame, pl.DataFrame]:
    """Return the true tasks and executions of a session."""
    if isinstance(work, CoupledWork):
        tasks = coupled_tasks(session, work.cell, clock_s)
        return tasks, coupled_executions(tasks, session)
    tasks = task_table(session, clock_s)
    plans = {execution.index: execution for execution in work.executions}
    return tasks, execution_table(tasks, session.name, plans)


def _write_session(folder: Path, session: Session, work: Work | CoupledWork) -> None:
    folder.mkdir()
    options = work.options
    frames = record(session, options, stream(work.seed, work.scene, TRACKER, session.index))
    robot = measured(session.robot, options.encoder_noise_rad, stream(work.seed, work.scene, ENCODER, session.index))
    if options.logs == "mcap":
        write_bag(folder / f"{session.name}.mcap", session, robot, frames[0], options)
        return
    events, inputs = _signal_logs(work)
    fields = options.people in ("signals", "both")
    write_robot(folder / "robot.csv", robot, options, inputs=inputs or (fields and not work.scene.plc))
    if fields and options.plc_trace:
        write_trace(folder / "plc.csv", session, work.scene.fields, options.plc_trace)
    elif fields and work.scene.plc:
        write_plc(folder / "plc.csv", session, work.scene.fields)
    if options.people in ("tracker", "both"):
        write_people(folder / "operator.csv", frames, options, session.name)
        if events:
            write_events(folder / "events.csv", session, options)


def _signal_logs(work: Work | CoupledWork) -> tuple[bool, bool]:
    """Return whether there are event logs, and digital inputs in the robot's log."""
    if isinstance(work, CoupledWork):
        return work.signal_logs
    return not work.scene.habits, work.options.causes is not None


def _facts(work: Work | CoupledWork) -> str:
    options = dataclasses.asdict(dataclasses.replace(work.options, rule=None))
    del options["rule"]  # stored as the safety function below
    if work.options.causes is None:
        del options["causes"]
    signals = work.options.people in ("signals", "both")
    if work.options.people == "tracker":
        del options["people"]
    if work.options.plc_trace is None:
        del options["plc_trace"]
    if not work.options.products:
        del options["products"]
    options["operator_log"] = work.options.operator_log.name if work.options.operator_log else None
    more: dict[str, object]
    if isinstance(work, CoupledWork):
        feed = dataclasses.asdict(work.cell.feed) if work.cell.feed else None
        waits = listed_conditions(work.cell) if work.options.task_list else conditions(work.cell)
        more = {"process_s": work.cell.robot_s, "conditions": waits, "feed": feed}
    else:
        del options["coupling"], options["signals"], options["task_list"]
        more = dict(zip(("pick_s", "place_s"), process_times(work), strict=True))
    scene = work.scene
    facts = {
        "scene": scene.name,
        "seed": work.seed,
        "executions": len(work.executions),
        "options": options,
        "safety": {"kind": type(scene.safety).__name__, **msgspec.to_builtins(scene.safety)},
        "places": scene.places,
        "human_places": {name: station.xyz_m for name, station in scene.stations.items()},
        **more,
        **({"fields": [dataclasses.asdict(one) for one in scene.fields], "other_bits": NAMES} if signals else {}),
    }
    return json.dumps(facts, indent=2, default=np.ndarray.tolist) + "\n"
