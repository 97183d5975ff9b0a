"""The tracker: the people as logged, in the tracker's clock and frame, with noise and lost frames.

It starts recording a few seconds before the robot's logger and sees them all the time. `write_csv` and
`write_bag` write its file.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from cyclekit_sim.arm import Array
from cyclekit_sim.options import SimulationOptions
from cyclekit_sim.session import Session

_LOST_S = 0.25  # s, mean length of a dropout
_TAIL_S = 1.0


@dataclass(frozen=True)
class Frames:
    """M frames of a take.

    Attributes:
        t_s: Tracker clock, 0 at the start of the take (M,).
        session_s: True time of each frame, session time (M,).
        xyz_m: Measured position of the person in the base frame, NaN where not seen (M, 3).
        heading_rad: Direction of walking about the base's vertical (M,).
        body: Name that the tracker gives this body.
    """

    t_s: Array
    session_s: Array
    xyz_m: Array
    heading_rad: Array
    body: str = "Operator"


def lead_s(options: SimulationOptions) -> float:
    """Return the time from the start of the take to the robot's first sample, s, according to cell.toml."""
    return 5.0 + float(np.ceil(max(0.0, options.clock_offset_s)))


def tracker_time(session_s: Array, options: SimulationOptions) -> Array:
    """Return the tracker's time at session times, with the errors of its clock."""
    return np.asarray((session_s + lead_s(options)) * (1 + options.clock_drift) - options.clock_offset_s)


def record(session: Session, options: SimulationOptions, rng: np.random.Generator) -> list[Frames]:
    """Return the take of a session, one entry per body that the tracker tells apart."""
    last = float(tracker_time(np.array([session.end_s + _TAIL_S]), options)[0])
    t_s = np.arange(int(last * options.tracker_rate_hz) + 1) / options.tracker_rate_hz
    session_s = (t_s + options.clock_offset_s) / (1 + options.clock_drift) - lead_s(options)
    bodies = []
    for number in range(session.people):
        true_m = session.person(session_s, number)
        measured = true_m + rng.normal(0.0, 1.0, true_m.shape) * options.delta_m
        measured[_lost(len(t_s), options, rng)] = np.nan
        bodies.append(
            Frames(t_s, session_s, measured, _heading(true_m), f"Operator {number + 1}" if number else "Operator")
        )
    return _renamed(_swapped(bodies, options, rng), options, rng)


def _swapped(bodies: list[Frames], options: SimulationOptions, rng: np.random.Generator) -> list[Frames]:
    """Return two bodies with exchanged ids from each of some random times on."""
    if not options.swap_ids_s or len(bodies) != 2:
        return bodies
    swapped = (np.cumsum(_happens(bodies[0], options.swap_ids_s, rng)) % 2 == 1)[:, None]
    first, second = (one.xyz_m for one in bodies)
    return [
        replace(bodies[0], xyz_m=np.where(swapped, second, first)),
        replace(bodies[1], xyz_m=np.where(swapped, first, second)),
    ]


def _renamed(bodies: list[Frames], options: SimulationOptions, rng: np.random.Generator) -> list[Frames]:
    """Return the bodies, each as a new one from each of some random times on."""
    if not options.lost_ids_s:
        return bodies
    found: list[Frames] = []
    for body in bodies:
        part = np.cumsum(_happens(body, options.lost_ids_s, rng))
        for number in range(int(part[-1]) + 1):
            mine = np.where((part == number)[:, None], body.xyz_m, np.nan)
            found.append(replace(body, xyz_m=mine, body=f"Operator {len(found) + 1}" if found else "Operator"))
    return found


def _happens(body: Frames, mean_s: float, rng: np.random.Generator) -> NDArray[np.bool_]:
    """Return in which frames something happens that does so every `mean_s` on average (M,)."""
    return np.asarray(rng.random(len(body.t_s)) < np.gradient(body.t_s) / mean_s)


def in_tracker_frame(xyz_m: Array, options: SimulationOptions) -> Array:
    """Return base-frame positions (M, 3) in the tracker's frame, Z up."""
    yaw = np.deg2rad(options.tracker_yaw_deg)
    c, s = np.cos(yaw), np.sin(yaw)
    apart = xyz_m - np.array(options.tracker_xyz_m)
    return np.stack([c * apart[:, 0] + s * apart[:, 1], c * apart[:, 1] - s * apart[:, 0], apart[:, 2]], axis=1)


def _lost(count: int, options: SimulationOptions, rng: np.random.Generator) -> NDArray[np.bool_]:
    """Return a mask of lost frames (M,): bursts of random length, with the requested fraction in total."""
    lost = np.zeros(count, dtype=bool)
    if options.dropout == 0:
        return lost
    burst = max(1.0, _LOST_S * options.tracker_rate_hz)
    seen = burst * (1 - options.dropout) / options.dropout
    bursts = int(2 * count / (burst + seen)) + 20
    lengths = np.stack([rng.geometric(1 / max(1.0, seen), bursts), rng.geometric(1 / burst, bursts)], axis=1).ravel()
    state = np.repeat(np.arange(2 * bursts) % 2 == 1, lengths)[:count]
    lost[: len(state)] = state
    return lost


def _heading(xyz_m: Array) -> Array:
    """Return the direction of walking (M,), rad; held while the person stands."""
    if len(xyz_m) < 2:
        return np.zeros(len(xyz_m))
    step = np.gradient(xyz_m[:, :2], axis=0)
    walking = np.linalg.norm(step, axis=1) > 1e-4
    held = np.maximum.accumulate(np.where(walking, np.arange(len(step)), 0))
    return np.asarray(np.arctan2(step[held, 1], step[held, 0]) * (walking[held]))
