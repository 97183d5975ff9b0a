"""Where the tool is, out of the transforms of a bag: base -> ... -> tool, link by link.

A driver publishes either one transform from the base to the tool, or one per link. Links that never move come once;
the others are taken at the moments of the link that is written most often, each nearest in time. Metres; rotations
as x, y, z, w.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

if TYPE_CHECKING:
    from cyclekit_adapters.rosbag.container import Message

Array = npt.NDArray[np.float64]
_TOOLS = ("tool0_controller", "tool0", "tcp", "flange", "ee_link")
_BASES = ("base", "base_link")


@dataclass
class Link:
    """The transforms of one frame in its parent, in the order of the bag."""

    parent: str
    receive_s: list[float] = field(default_factory=list)
    stamp_s: list[float] = field(default_factory=list)
    pose: list[tuple[float, ...]] = field(default_factory=list)


class Transforms:
    """All links of a bag, by the name of the child frame."""

    def __init__(self) -> None:
        self.links: dict[str, Link] = {}

    def add(self, message: Message, receive_s: float) -> None:
        """Take in one TFMessage."""
        for item in message.transforms:
            child, parent = item.child_frame_id.strip("/"), item.header.frame_id.strip("/")
            move, turn = item.transform.translation, item.transform.rotation
            pose = tuple(map(float, (move.x, move.y, move.z, turn.x, turn.y, turn.z, turn.w)))
            stamp_s = float(item.header.stamp.sec + item.header.stamp.nanosec * 1e-9)
            link = self.links.setdefault(child, Link(parent))
            link.receive_s.append(receive_s)
            link.stamp_s.append(stamp_s)
            link.pose.append(pose)

    def chain(self, base: str | None, tool: str | None) -> list[Link]:
        """Return the links from base to tool, empty if there is no such chain.

        Args:
            base: Frame of the base; by default `base`, then `base_link`, with any prefix.
            tool: Frame of the tool; by default the first known name, with any prefix.
        """
        tools = [tool] if tool else [c for name in _TOOLS for c in self.links if _is(c, name)]
        for start in tools:
            for end in [base] if base else _BASES:
                if found := self._up(start, end):
                    return found
        return []

    def _up(self, tool: str, base: str) -> list[Link]:
        found: list[Link] = []
        frame = tool
        while frame in self.links and len(found) <= len(self.links):
            link = self.links[frame]
            found.insert(0, link)
            if _is(link.parent, base):
                return found
            frame = link.parent
        return []


def _is(frame: str, name: str) -> bool:
    return frame == name or frame.endswith(f"/{name}") or (name not in _BASES and frame.endswith(f"_{name}"))


def tool_path(chain: list[Link], *, stamped: bool) -> tuple[Array, Array]:
    """Return when and where the tool was.

    Args:
        chain: Links from base to tool, not empty.
        stamped: Use the time in the message, else the time the bag received it.

    Returns:
        Times, shape (T,), s; positions in the base frame, shape (T, 3), m.
    """
    times = [np.asarray(link.stamp_s if stamped else link.receive_s) for link in chain]
    t_s = np.unique(max(times, key=len))
    place, turn = np.zeros((t_s.size, 3)), np.tile([0.0, 0.0, 0.0, 1.0], (t_s.size, 1))
    for link, own in zip(chain, times, strict=True):
        pose = np.asarray(link.pose)[_nearest(own, t_s)]
        place = place + _rotate(turn, pose[:, :3])
        turn = _multiply(turn, pose[:, 3:])
    return t_s, place


def _nearest(times: Array, wanted: Array) -> npt.NDArray[np.int64]:
    order = np.argsort(times, kind="stable")
    ordered = times[order]
    after = np.clip(np.searchsorted(ordered, wanted), 0, ordered.size - 1)
    before = np.clip(after - 1, 0, ordered.size - 1)
    closer = np.abs(ordered[before] - wanted) <= np.abs(ordered[after] - wanted)
    chosen: npt.NDArray[np.int64] = order[np.where(closer, before, after)]
    return chosen


def _rotate(turn: Array, move: Array) -> Array:
    axis, scalar = turn[:, :3], turn[:, 3:]
    twice = 2.0 * np.cross(axis, move)
    rotated: Array = move + scalar * twice + np.cross(axis, twice)
    return rotated


def _multiply(first: Array, second: Array) -> Array:
    a, u = first[:, 3:], first[:, :3]
    b, v = second[:, 3:], second[:, :3]
    return np.hstack([a * v + b * u + np.cross(u, v), a * b - np.sum(u * v, axis=1, keepdims=True)])
