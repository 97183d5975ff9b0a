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
    from cyclekit_adapters.rosbag.decode import Group

Array = npt.NDArray[np.float64]
_TOOLS = ("tool0_controller", "tool0", "tcp", "flange", "ee_link")
_BASES = ("base", "base_link")


@dataclass
class Link:
    """The transforms of one frame in its parent, in the order of time.

    Attributes:
        parent: Name of the parent frame.
        receive_s, stamp_s: When received and stamped, shape (N,), s.
        pose: x, y, z in m and the rotation as x, y, z, w, shape (N, 7).
    """

    parent: str
    receive_s: Array = field(default_factory=lambda: np.zeros(0))
    stamp_s: Array = field(default_factory=lambda: np.zeros(0))
    pose: Array = field(default_factory=lambda: np.zeros((0, 7)))


class Transforms:
    """All links of a bag, by the name of the child frame; complete once `finish` was called."""

    def __init__(self) -> None:
        self.links: dict[str, Link] = {}
        self._parts: dict[str, list[tuple[Array, Array, Array]]] = {}

    def add(self, group: Group) -> None:
        """Take in a group of TFMessages."""
        found = []
        for number, item in enumerate(group.first("transforms")):
            child, parent = item.child_frame_id.strip("/"), item.header.frame_id.strip("/")
            here = ("transforms", number, "transform")
            moves = [group.numbers(*here, "translation", axis) for axis in "xyz"]
            turns = [group.numbers(*here, "rotation", axis) for axis in "xyzw"]
            stamp = [group.numbers("transforms", number, "header", "stamp", part) for part in ("sec", "nanosec")]
            stamp_s: Array = np.add(stamp[0], stamp[1] * 1e-9, dtype=np.float64)
            pose: Array = np.stack([*moves, *turns], axis=1).astype(np.float64)
            found.append((child, parent, stamp_s, pose))
        receive_s = group.receive_ns.astype(np.float64) * 1e-9
        for child, parent, stamp_s, pose in found:
            self.links.setdefault(child, Link(parent))
            self._parts.setdefault(child, []).append((receive_s, stamp_s, pose))

    def finish(self) -> None:
        """Put what was taken in into the order of time."""
        for child, link in self.links.items():
            link.receive_s, link.stamp_s, link.pose = (
                np.concatenate(part) for part in zip(*self._parts[child], strict=True)
            )
            order = np.argsort(link.receive_s, kind="stable")
            link.receive_s, link.stamp_s, link.pose = link.receive_s[order], link.stamp_s[order], link.pose[order]

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

    def bodies(self, base: str | None) -> dict[str, tuple[list[Link], bool]]:
        """Return the links to each person's body (ROS4HRI), by id, and whether they begin at the base.

        A `person_<id>` is not the same point: it is the face.

        Args:
            base: Frame of the base; by default `base`, then `base_link`, with any prefix.
        """
        found = {}
        for child in sorted(self.links):
            name = child.rpartition("/")[2]
            if name.startswith("body_"):
                chains = [self._up(child, end) for end in ([base] if base else _BASES)]
                chain = next((chain for chain in chains if chain), [])
                found[name.removeprefix("body_")] = (chain or self._to_root(child), bool(chain))
        return found

    def _to_root(self, frame: str) -> list[Link]:
        found: list[Link] = []
        while frame in self.links and len(found) <= len(self.links):
            found.insert(0, self.links[frame])
            frame = self.links[frame].parent
        return found

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


def chain_path(chain: list[Link], *, stamped: bool, own_times: bool = False) -> tuple[Array, Array]:
    """Return when and where the end of a chain was.

    Args:
        chain: Links from base to tool or person, not empty.
        stamped: Use the time in the message, else the time the bag received it.
        own_times: Tell only the moments of the last link (a person who is not tracked is nowhere), else those of
            the link that is written most often.

    Returns:
        Times, shape (T,), s; positions in the base frame, shape (T, 3), m.
    """
    times = [link.stamp_s if stamped else link.receive_s for link in chain]
    t_s = np.unique(times[-1] if own_times else max(times, key=len))
    place, turn = np.zeros((t_s.size, 3)), np.tile([0.0, 0.0, 0.0, 1.0], (t_s.size, 1))
    for link, own in zip(chain, times, strict=True):
        pose = link.pose[_nearest(own, t_s)]
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
