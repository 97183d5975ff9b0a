"""One base frame: transform positions from a log's frame to the robot base frame.

The cell file gives the pose of a tracker, and its up axis if that is y. The pose can be fitted to points that robot and
tracker both touched; `calibrate` reads such points.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

from cyclekit.config import Frame
from cyclekit.errors import ConfigError, ShapeError
from cyclekit.text.numbers import compact, fixed, given, signed

if TYPE_CHECKING:
    from cyclekit.schema import Floats

MIN_SPREAD_M = 0.05
"""Minimum spread of points off a line, m; with less, the rotation about that line is unknown."""
MILLIMETRES = 1000.0
SCALE_SLACK = 0.2


@dataclass(frozen=True)
class FrameFit:
    """Pose of a tracker's frame, and the residuals of the points.

    Attributes:
        frame: The rigid transform p_base = rotation @ p + xyz_m, after rotation of the up axis to z.
        residual_m: Distance of each point from its fitted position, shape (N,), m.
        rms_m: Root mean square of the residuals, m.
        scale: Ratio of the points' spread in the base frame to that in the tracker's; 1 except for noise.
        warnings: Doubts about the fit.
    """

    frame: Frame
    residual_m: Floats
    rms_m: float
    scale: float
    warnings: tuple[str, ...]


def stood_up(points_m: Floats, up: Literal["y", "z"]) -> Floats:
    """Return points (N, 3) with z up; y up is rotated by +90 deg about x."""
    if up == "z":
        return points_m
    return np.column_stack([points_m[:, 0], -points_m[:, 2], points_m[:, 1]])


def to_base(points_m: Floats, frame: Frame | None, *, up: Literal["y", "z"] = "z") -> Floats:
    """Return positions in the robot base frame.

    Args:
        points_m: Positions in the log's frame, shape (N, 3), m; NaN stays NaN.
        frame: Pose of the log's frame; None: positions are only rotated to z up.
        up: Axis that points up in the log. For "y" (OptiTrack's convention), positions are first rotated by +90 deg
            about x, so that (x, y, z) becomes (x, -z, y): right-handed and z up.

    Returns:
        Positions, shape (N, 3), m.

    Raises:
        ShapeError: `points_m` is not (N, 3).
    """
    if points_m.ndim != 2 or points_m.shape[1] != 3:
        msg = f"points_m {points_m.shape} must be (N, 3)"
        raise ShapeError(msg)
    turned = stood_up(points_m, up)
    if frame is None:
        return turned.copy()
    rotation = np.asarray(frame.rotation)
    placed: Floats = turned @ rotation.T + np.asarray(frame.xyz_m)
    flat = np.isnan(turned[:, 2]) & np.isfinite(turned[:, :2]).all(axis=1)
    if flat.any() and np.abs(rotation[:2, 2]).max() < 1e-6:  # planar tracker: only the height is unknown
        placed[flat, :2] = turned[flat, :2] @ rotation[:2, :2].T + np.asarray(frame.xyz_m)[:2]
    return placed


def fit_frame(log_m: Floats, base_m: Floats, *, up: Literal["y", "z"] = "z") -> FrameFit:
    """Return the pose of a log's frame from points known in both, by least squares (Kabsch; Umeyama without scale).

    Args:
        log_m: The points in the log's frame and axes, shape (N, 3), N >= 3, m.
        base_m: The same points in the robot base frame, shape (N, 3), m.
        up: Axis that points up in the log, as for `to_base`.

    Raises:
        ShapeError: The arrays are not both (N, 3), or contain values that are not finite.
        ConfigError: Fewer than three points, all near one line, in different units, or mirrored.
    """
    if log_m.shape != base_m.shape or log_m.ndim != 2 or log_m.shape[1] != 3:
        raise ShapeError(f"log_m {log_m.shape} and base_m {base_m.shape} must be (N, 3)")
    if not (np.isfinite(log_m).all() and np.isfinite(base_m).all()):
        raise ShapeError("log_m and base_m must be finite")
    if len(log_m) < 3:
        raise ConfigError(f"{len(log_m)} points are too few for a frame", cure="Touch four or more, well apart.")
    here = stood_up(log_m, up)
    a, b = here - here.mean(axis=0), base_m - base_m.mean(axis=0)
    scale = _scale(a, b)
    _refuse_line(a, b)
    turn, mirrored = _turn(a, b)
    residual = np.linalg.norm(b - a @ turn.T, axis=1)
    rms = float(np.sqrt(np.mean(residual**2)))
    if mirrored and rms > 0.02:
        raise ConfigError(
            f"the points fit only if mirrored (residual otherwise {fixed(1000 * rms, 0)} mm rms)",
            cure="One axis has the wrong sign, or the tracker counts y upwards: try --up y.",
        )
    origin = base_m.mean(axis=0) - turn @ here.mean(axis=0)
    x, y, z = ((float(row[0]), float(row[1]), float(row[2])) for row in turn)
    frame = Frame((float(origin[0]), float(origin[1]), float(origin[2])), (x, y, z))
    return FrameFit(frame, residual, rms, scale, tuple(_doubts(a, b, rms, scale)))


def _turn(a: Floats, b: Floats) -> tuple[Floats, bool]:
    """Return the best rotation of centred points `a` onto `b`, and whether a reflection would fit better."""
    u, weight, vt = np.linalg.svd(a.T @ b)
    mirrored = bool(np.linalg.det(vt.T @ u.T) < 0)
    turn = vt.T @ np.diag([1.0, 1.0, -1.0 if mirrored else 1.0]) @ u.T
    return turn, mirrored and bool(weight[2] > 0.01 * weight[0])  # planar points equal their reflection


def _scale(a: Floats, b: Floats) -> float:
    size = np.sqrt(np.sum(a * a)), np.sqrt(np.sum(b * b))
    if min(size) < 1e-9:
        raise ConfigError("all points are at one position", cure="Touch four or more, well apart.")
    scale = float(size[1] / size[0])
    for factor, whose in ((1 / MILLIMETRES, "the tracker's"), (MILLIMETRES, "the robot's")):
        if abs(scale / factor - 1) < SCALE_SLACK:
            raise ConfigError(
                f"{whose} points are {given(MILLIMETRES)} times as far apart as the other's: millimetres "
                "taken for metres",
                cure=f"Name {whose} columns …_mm instead of …_m.",
            )
    if not 0.5 < scale < 2:
        raise ConfigError(
            f"the robot's points are {compact(scale, 3)} times as far apart as the tracker's",
            cure="Check the units of the columns, and that each row is one point.",
        )
    return scale


def _refuse_line(a: Floats, b: Floats) -> None:
    for points, whose in ((a, "tracker"), (b, "robot")):
        across = np.linalg.svd(points, compute_uv=False)[1] / np.sqrt(len(points))
        if across < MIN_SPREAD_M:
            seen = f"the points of the {whose} lie within {fixed(1000 * across, 0)} mm of one line"
            raise ConfigError(
                f"{seen}: the rotation of the frame about that line is unknown",
                cure="Touch points off the line as well, half a metre or more.",
            )


def _doubts(a: Floats, b: Floats, rms: float, scale: float) -> list[str]:
    found = []
    if len(a) == 3:
        found.append("three points fit almost any frame: touch a fourth to check it")
    if abs(scale - 1) > 0.02:
        found.append(
            f"the robot's points are {signed(100 * (scale - 1), 1)} % farther apart than the tracker's: check both"
        )
    if rms <= 0.01:
        return found
    others, worst = _without_worst(a, b)
    if others < 0.3 * rms:
        found.append(
            f"point {worst + 1} does not fit: without it the others agree within {fixed(1000 * others, 1)} mm (rms), "
            f"with it within {fixed(1000 * rms, 0)} mm; touch it again or remove it"
        )
    elif rms > 0.02:
        found.append(f"the points disagree by {fixed(1000 * rms, 0)} mm (rms): check that each row is one point")
    return found


def _without_worst(a: Floats, b: Floats) -> tuple[float, int]:
    """Return the minimum rms with one point left out, m, and the index of that point; at least four remain."""
    best, worst = np.inf, 0
    for row in range(len(a) if 5 <= len(a) <= 100 else 0):
        here, there = np.delete(a, row, axis=0), np.delete(b, row, axis=0)
        here, there = here - here.mean(axis=0), there - there.mean(axis=0)
        rms = float(np.sqrt(np.mean(np.sum((there - here @ _turn(here, there)[0].T) ** 2, axis=1))))
        if rms < best:
            best, worst = rms, row
    return best, worst
