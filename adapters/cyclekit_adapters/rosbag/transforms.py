"""The transforms of a bag as a tree of frames, and the chain from one frame to another.

A driver publishes either one transform from base to tool, or one per link; a calibrated camera is published once, on
`/tf_static`. A frame has one parent. If a bag names several (two cameras that see one body), the most frequent one is
used, with a warning. `chain` evaluates a chain over time.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

if TYPE_CHECKING:
    from cyclekit_adapters.rosbag.decode import Group
    from cyclekit_adapters.rosbag.payloads import Ints

Array = npt.NDArray[np.float64]
TOOLS = ("tool0_controller", "tool0", "tcp", "flange", "ee_link", "link_ee", "link8")
BASES = ("base", "base_link", "link0", "link_0")
"""Base frames, those of a UR first; Franka's is `fr3_link0`, KUKA's `iiwa_link_0`. Franka's flange is `fr3_link8`."""
_UNDERSCORED = {*TOOLS, *BASES[2:]}


@dataclass
class FrameTransforms:
    """Transforms of one frame in its parent, in message order.

    Attributes:
        parent, child: Names of the frames.
        topic: Topic of the messages; `index`: their indices within it, shape (N,).
        receive_s, stamp_s: Receive times and header stamps, shape (N,), s.
        pose: x, y, z in m and the rotation as x, y, z, w, shape (N, 7).
        times: Times in the log's clock, shape (N,), s; set when that clock is chosen.
    """

    parent: str
    child: str
    topic: str = ""
    index: Ints = field(default_factory=lambda: np.zeros(0, np.int64))
    receive_s: Array = field(default_factory=lambda: np.zeros(0))
    stamp_s: Array = field(default_factory=lambda: np.zeros(0))
    pose: Array = field(default_factory=lambda: np.zeros((0, 7)))
    times: Array = field(default_factory=lambda: np.zeros(0))

    @property
    def name(self) -> str:
        """Name of this link in messages."""
        return f"transform {self.parent} -> {self.child} on {self.topic}"

    def is_still(self) -> bool:
        """Return whether the pose is constant."""
        return bool((self.pose == self.pose[:1]).all())


@dataclass(frozen=True)
class Link:
    """One link of a chain; `inverse`: from child to parent."""

    transforms: FrameTransforms
    inverse: bool = False

    def __str__(self) -> str:
        return self.transforms.parent if self.inverse else self.transforms.child


class Transforms:
    """All links of a bag, by name of the child frame; complete after `finish`."""

    def __init__(self) -> None:
        self.links: dict[str, FrameTransforms] = {}
        self.several_parents: dict[str, list[str]] = {}
        self._parts: dict[tuple[str, str, str], list[tuple[Ints, Array, Array, Array]]] = {}

    def add(self, topic: str, number: Ints, group: Group) -> None:
        """Add a group of TFMessages; `number` is the arrival number of each, shape (N,)."""
        found = []
        for entry, item in enumerate(group.first("transforms")):
            child, parent = _plain(item.child_frame_id), _plain(item.header.frame_id)
            here = ("transforms", entry, "transform")
            moves = [group.numbers(*here, "translation", axis) for axis in "xyz"]
            turns = [group.numbers(*here, "rotation", axis) for axis in "xyzw"]
            stamp = [group.numbers("transforms", entry, "header", "stamp", part) for part in ("sec", "nanosec")]
            stamp_s: Array = np.add(stamp[0], stamp[1] * 1e-9, dtype=np.float64)
            pose: Array = np.stack([*moves, *turns], axis=1).astype(np.float64)
            found.append((child, parent, stamp_s, pose))
        receive_s = group.receive_ns.astype(np.float64) * 1e-9
        for child, parent, stamp_s, pose in found:
            self._parts.setdefault((child, parent, topic), []).append((number, receive_s, stamp_s, pose))

    def finish(self, order: Callable[[str], Ints]) -> None:
        """Build the links from the added messages; `order` gives the index of each arrival number of a topic."""
        best: dict[str, tuple[int, str, str]] = {}
        for (child, parent, topic), parts in self._parts.items():
            count = sum(number.size for number, *_ in parts)
            best[child] = max(best.get(child, (0, "", "")), (count, parent, topic))
            self.several_parents.setdefault(child, []).append(parent)
        for child, (_, parent, topic) in best.items():
            number, receive_s, stamp_s, pose = (
                np.concatenate(part) for part in zip(*self._parts[child, parent, topic], strict=True)
            )
            index = order(topic)[number]
            by_index = np.argsort(index, kind="stable")
            link = FrameTransforms(
                parent, child, topic, index[by_index], receive_s[by_index], stamp_s[by_index], pose[by_index]
            )
            link.times = link.receive_s
            self.links[child] = link
        self.several_parents = {
            child: sorted(set(parents)) for child, parents in self.several_parents.items() if len(set(parents)) > 1
        }

    def frames(self) -> set[str]:
        """Return the names of all frames."""
        return set(self.links) | {link.parent for link in self.links.values()}

    def chain(self, base: str, frame: str) -> list[Link] | None:
        """Return the chain from one frame to another, empty if both are the same; None if they are not connected."""
        there, back = self._up(_plain(frame)), self._up(_plain(base))
        above = [_plain(frame), *(link.parent for link in there)]
        common = next((name for name in [_plain(base), *(link.parent for link in back)] if name in above), None)
        if common is None:
            return None
        begin = [_plain(base), *(link.parent for link in back)].index(common)
        forth = there[: above.index(common)]
        return [
            *(Link(link, inverse=True) for link in back[:begin]),
            *(Link(link) for link in reversed(forth)),
        ]

    def tool_chain(self, base: str | None, tool: str | None) -> tuple[str, list[Link], list[str]] | None:
        """Return base frame, chain from base to tool, and tools of other arms; None if there is no chain.

        Args:
            base: Base frame; by default the one with the tool's prefix, then the first of `BASES`.
            tool: Tool frame; by default the first known name, with any prefix.
        """
        for name in [tool] if tool else TOOLS:
            alike = [tool] if tool else sorted(child for child in self.links if is_named(child, name))
            found = [(start, *chain) for start in alike if (chain := self._chain_to(base, start, name))]
            exact = [one for one in found if _plain(one[0]) == name]
            if found:
                start, end, steps = (exact or found)[0]
                return end, steps, [] if exact else [other for other, *_ in found if other != start]
        return None

    def _chain_to(self, base: str | None, tool: str, name: str) -> tuple[str, list[Link]] | None:
        above = [link.parent for link in reversed(self._up(_plain(tool)))]
        prefix = _plain(tool).removesuffix(name)
        own = [] if base else [prefix + end for end in BASES if prefix + end in above]
        chains = ((end, self.chain(end, tool)) for end in [*own, *self.bases(base, above)])
        return next(((end, chain) for end, chain in chains if chain), None)

    def bases(self, base: str | None, first: Iterable[str] = ()) -> list[str]:
        """Return the possible base frames of the robot, those in `first` before others."""
        if base:
            return [_plain(base)]
        above = list(first)
        others = sorted(self.frames() - set(above))
        return [frame for names in (above, others) for name in BASES for frame in names if is_named(frame, name)]

    def bodies(self) -> dict[str, str]:
        """Return the frame of each person's body (ROS4HRI), by id; `person_<id>` is a face, not a body."""
        names = {child: child.rpartition("/")[2] for child in sorted(self.links)}
        return {name.removeprefix("body_"): child for child, name in names.items() if name.startswith("body_")}

    def root(self, frame: str) -> str:
        """Return the root frame above a frame."""
        above = self._up(_plain(frame))
        return above[-1].parent if above else _plain(frame)

    def _up(self, frame: str) -> list[FrameTransforms]:
        """Return the links from a frame to the root."""
        found: list[FrameTransforms] = []
        while frame in self.links and len(found) <= len(self.links):
            found.append(self.links[frame])
            frame = self.links[frame].parent
        return found


def _plain(frame: str) -> str:
    return frame.strip("/")


def is_named(frame: str, name: str) -> bool:
    """Return whether a frame has a name, with any prefix; for `base` only a prefix that ends in a slash."""
    return frame == name or frame.endswith(f"/{name}") or (name in _UNDERSCORED and frame.endswith(f"_{name}"))
