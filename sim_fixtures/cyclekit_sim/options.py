"""Options of a simulation: log format, imperfections of the logs, dynamics of the safety function.

All are off by default: perfect clocks, a noiseless tracker, a scaling without delay. `scenes` defines the cells
(places, thresholds, walking).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from cyclekit_sim.causes import MixedCauses
from cyclekit_sim.errors import SimulationError

if TYPE_CHECKING:
    from cyclekit_sim.rules import Rule


@dataclass(frozen=True)
class Product:
    """A product with its own program: places in visiting order, home first and last, and what it needs at some, s.

    `process_s` is a standstill in addition to picking or placing, at every visit of that place.
    """

    places: tuple[str, ...]
    process_s: dict[str, float]


@dataclass(frozen=True)
class SimulationOptions:
    """Format and imperfections of the logs, and dynamics of the cell.

    Attributes:
        logs: "csv" writes record.py, Motive and event CSVs; "mcap" writes one ROS 2 bag per session.
        robot_rate_hz: Controller rate and log rate, 125 or 500 Hz.
        tracker_rate_hz: Frames per second of the tracker.
        delta_m: Tracker noise, standard deviation per axis; white, in the log only.
        swap_ids_s: Mean time between exchanges of the ids of two people, s; 0: never.
        lost_ids_s: Mean time after which a person gets a new id, s; 0: never.
        dropout: Fraction of tracker frames lost, in bursts; 0 to below 1.
        clock_offset_s: Delay of the tracker's clock relative to cell.toml.
        clock_drift: Rate error of the tracker's clock (50e-6: 50 ppm fast).
        tracker_xyz_m: Position of the tracker's origin, robot base frame; z is the height of the floor.
        tracker_yaw_deg: Rotation of the tracker about the vertical.
        millimetres: The tracker writes millimetres (and says so in its header).
        silent_when_empty: The tracker writes no rows while it sees no person (CSV).
        log_outputs: False omits the gripper's output and the register of the execution from the CSV.
        log_override: False omits the two scaling columns (or the scaling topic) from the logs.
        moves_slider: A program applies the safety function by the speed slider: `target_speed_fraction` is its
            scaling (times the slider that a hand set), and `speed_scaling` 1 (CSV).
        ramp_down_per_s: Maximum fall of s per second; None: it jumps.
        ramp_up_per_s: Maximum rise of s per second; None: it jumps.
        latency_s: Age of the positions that s reacts to.
        hysteresis_m: Additional distance beyond the threshold before s rises again.
        hold_s: Time for which s stays low after the safety function allows more.
        rule: Safety function that replaces the scene's.
        operator_log: Real tracker recording that replaces the simulated operator.
        operator_xyz_m: Position of the recording's origin (Z up) in the base frame.
        operator_yaw_deg: Rotation of the recording about the vertical.
        executions_per_session: Number of executions in a session; at least 60 for a scene recorded without pauses.
        with_operator: False is the reference run, with an empty cell.
        encoder_noise_rad: Noise of the joint angles, standard deviation at the big joints (five times as much at the
            wrists); a real UR5 shows 2e-5.
        pick_s: Process time of picking, instead of the scene's.
        place_s: Process time of placing, instead of the scene's.
        causes: Causes of lost time other than the person (CSV); None: none.
        people: Information on people in the logs (CSV): the tracker, signals of fields, both or none; None: as in the
            scene. With signals, the safety function is that of the scene's fields.
        plc_trace: The signals of the fields are in a PLC's trace instead of the robot's log (CSV), with one column per
            tag ("wide") or rows of tag, time and value ("long"); None: as in the scene.
        coupling: Share of joint tasks in which robot and operator wait, in cells with waits (CSV).
        pace_drift: Share by which the operator's walks and work become shorter over many executions, in such cells.
        pace_executions: Number of executions in which 63 % of that have happened (exponential).
        paces: Durations of the operator's walks and work relative to the scene's, by session in turn: so many people
            who come in turn, in such cells.
        signals: False omits buttons and sensors from the logs of such cells.
        task_list: The logs of such a cell are only starts and ends of tasks.
        products: Products of which the executions are, in turn; without any, each execution draws its places.
    """

    logs: Literal["csv", "mcap"] = "csv"
    robot_rate_hz: int = 125
    tracker_rate_hz: int = 60
    delta_m: float = 0.0
    swap_ids_s: float = 0.0
    lost_ids_s: float = 0.0
    dropout: float = 0.0
    clock_offset_s: float = 0.0
    clock_drift: float = 0.0
    tracker_xyz_m: tuple[float, float, float] = (1.4, -2.6, -0.8)
    tracker_yaw_deg: float = 35.0
    millimetres: bool = False
    silent_when_empty: bool = False
    log_outputs: bool = True
    log_override: bool = True
    moves_slider: bool = False
    ramp_down_per_s: float | None = None
    ramp_up_per_s: float | None = None
    latency_s: float = 0.0
    hysteresis_m: float = 0.0
    hold_s: float = 0.0
    rule: Rule | None = None
    operator_log: Path | None = None
    operator_xyz_m: tuple[float, float, float] = (0.0, 2.35, -0.8)
    operator_yaw_deg: float = 0.0
    executions_per_session: int = 25
    with_operator: bool = True
    encoder_noise_rad: float = 0.0
    pick_s: float | None = None
    place_s: float | None = None
    causes: MixedCauses | None = None
    people: Literal["tracker", "signals", "both", "none"] | None = None
    plc_trace: Literal["wide", "long"] | None = None
    coupling: float = 1.0
    pace_drift: float = 0.0
    pace_executions: float = 60.0
    paces: tuple[float, ...] = (1.0,)
    signals: bool = True
    task_list: bool = False
    products: tuple[Product, ...] = ()

    def __post_init__(self) -> None:
        """Refuse impossible values, all in one error."""
        faults = [
            message
            for wrong, message in (
                (self.logs not in ("csv", "mcap"), f"logs is {self.logs!r}: use 'csv' or 'mcap'"),
                (self.robot_rate_hz not in (125, 500), f"robot_rate_hz is {self.robot_rate_hz}: use 125 or 500"),
                (self.tracker_rate_hz < 1, f"tracker_rate_hz is {self.tracker_rate_hz}: use 1 or more"),
                (self.delta_m < 0, f"delta_m is {self.delta_m}: a standard deviation is not negative"),
                (not 0 <= self.dropout < 1, f"dropout is {self.dropout}: use a fraction from 0 to below 1"),
                (self.latency_s < 0, f"latency_s is {self.latency_s}: use 0 or more"),
                (self.hysteresis_m < 0, f"hysteresis_m is {self.hysteresis_m}: use 0 or more"),
                (self.hold_s < 0, f"hold_s is {self.hold_s}: use 0 or more"),
                ((self.ramp_down_per_s or 1.0) <= 0, f"ramp_down_per_s is {self.ramp_down_per_s}: use more than 0"),
                ((self.ramp_up_per_s or 1.0) <= 0, f"ramp_up_per_s is {self.ramp_up_per_s}: use more than 0"),
                (self.ramp_down_per_s == 0, "ramp_down_per_s is 0: use more than 0, or None for a jump"),
                (self.ramp_up_per_s == 0, "ramp_up_per_s is 0: use more than 0, or None for a jump"),
                (self.encoder_noise_rad < 0, f"encoder_noise_rad is {self.encoder_noise_rad}: use 0 or more"),
                (min(self.pick_s or 1.0, self.place_s or 1.0) < 0, "pick_s and place_s are times: use 0 or more"),
                (self.executions_per_session < 1, "executions_per_session must be 1 or more"),
                (not 0 <= self.coupling <= 1, f"coupling is {self.coupling}: use a fraction from 0 to 1"),
                (not 0 <= self.pace_drift < 1, f"pace_drift is {self.pace_drift}: use a fraction from 0 to below 1"),
                (self.pace_executions <= 0, f"pace_executions is {self.pace_executions}: use more than 0"),
                (not self.paces or min(self.paces, default=1.0) <= 0, f"paces is {self.paces}: use factors above 0"),
                (self.causes is not None and self.logs == "mcap", "causes are written to CSV logs only"),
                (self.people not in (None, "tracker") and self.logs == "mcap", "people is for CSV logs only"),
                (
                    self.plc_trace not in (None, "wide", "long"),
                    f"plc_trace is {self.plc_trace!r}: use 'wide' or 'long'",
                ),
                (
                    self.plc_trace is not None and (self.logs == "mcap" or self.people in ("tracker", "none")),
                    "plc_trace holds the signals of fields, in CSV logs only",
                ),
                (self.plc_trace is not None and not self.log_outputs, "plc_trace needs the robot's outputs logged"),
            )
            if wrong
        ]
        if faults:
            raise SimulationError("; ".join(faults))

    @property
    def cycle_s(self) -> float:
        """Length of one control cycle, s."""
        return 1.0 / self.robot_rate_hz

    def pace(self, execution: int, session: int) -> float:
        """Return the durations of the operator's walks and work in an execution, relative to the scene's."""
        done = 1.0 - math.exp(-execution / self.pace_executions)
        return self.paces[session % len(self.paces)] * (1.0 - self.pace_drift * done)
