"""Frame of the people, and its transform to the robot's base.

The robot's base is the frame given in the cell file, else the one in the headers of the TCP pose, else the start of the
transforms to the tool. TCP poses in another frame are transformed to it, if transforms lead there; if none do, their
frame is the base. If the bag holds transforms from there to the frame of the people, their positions are transformed to
the base. If not, or if the cell file gives the pose of the log's frame, they stay in their frame.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from cyclekit_adapters.rosbag.chain import transformed
from cyclekit_adapters.rosbag.joints import of_human
from cyclekit_adapters.rosbag.people import Persons
from cyclekit_adapters.rosbag.tracks import JointStates
from cyclekit_adapters.rosbag.transforms import BASES, Array, FrameTransforms, is_named

if TYPE_CHECKING:
    from cyclekit_adapters.rosbag.roles import Roles
    from cyclekit_adapters.rosbag.tracks import Contents
    from cyclekit_adapters.rosbag.transforms import Link


@dataclass(frozen=True)
class TransformedBody:
    """A body among the transforms, or one of its joints.

    Attributes:
        person: Id of the body.
        chain: Links from the frame of the output positions.
        joint: Name of the joint; empty for the body.
    """

    person: str
    chain: list[Link]
    joint: str = ""

    @property
    def link(self) -> FrameTransforms:
        """The link whose times are those of the track."""
        return self.chain[-1].transforms


@dataclass
class Frames:
    """Chains of transforms that a bag needs.

    Attributes:
        base: The robot's base frame; empty if unknown.
        tool: Links from base to tool, if no topic holds the TCP.
        tcp: Links from base to the frame of the topic that holds the TCP, if that is another.
        ambiguous: Tool frames, if the transforms lead to several arms equally.
        people: Links from the base to each other frame of people.
        unconnected: Frames of people without a connection to the base.
        given: Frames of people whose pose the cell file gives; positions stay in them.
        bodies: Bodies among the transforms and, if requested, their joints.
    """

    base: str = ""
    tool: list[Link] = field(default_factory=list)
    tcp: list[Link] = field(default_factory=list)
    ambiguous: list[str] = field(default_factory=list)
    people: dict[str, list[Link]] = field(default_factory=dict)
    unconnected: set[str] = field(default_factory=set)
    given: set[str] = field(default_factory=set)
    bodies: list[TransformedBody] = field(default_factory=list)

    def links(self) -> list[FrameTransforms]:
        """Return all moving links, each once."""
        chains = [self.tool, self.tcp, *self.people.values(), *(body.chain for body in self.bodies)]
        found = {id(link.transforms): link.transforms for chain in chains for link in chain}
        own = {id(body.link) for body in self.bodies}
        return [link for key, link in found.items() if key in own or not link.is_still()]

    def placed(self, frame: str, at_s: Array, places: Array) -> Array:
        """Return positions of people, shape (T, 3) or (T, K, 3), m, in the output frame."""
        chain = self.people.get(frame.strip("/"))
        return transformed(chain, at_s, places) if chain else places


def find_frames(contents: Contents, roles: Roles, *, skeletons: bool, frame_given: bool) -> Frames:
    """Find the robot's base and the chains to the tool and to the people.

    Args:
        contents: Tracks and transforms of the bag; warnings are added to it.
        roles: Use of the topics.
        skeletons: Whether the joints of bodies are requested.
        frame_given: Whether the cell file gives the pose of the log's frame.
    """
    tree, frames = contents.transforms, Frames()
    if roles.tcp not in contents.tracks and (found := tree.tool_chain(roles.base_frame, roles.tool_frame)):
        frames.base, frames.tool, others = found
        frames.ambiguous = sorted([frames.tool[-1].transforms.child, *others]) if others else []
    own = contents.frame_of(roles.tcp).strip("/")
    frames.base = (roles.base_frame or own or frames.base).strip("/")
    _connect_bases(contents, roles, {own, frames.base})
    if own and own != frames.base:
        if (to_tcp := tree.chain(frames.base, own)) is None:
            none = f"no transforms from base_frame = {frames.base!r} to the frame of the TCP, {own!r}"
            contents.warnings.append(f"{none}: {own!r} is the base of all positions")
            frames.base = own
        frames.tcp = to_tcp or []
    seen = sorted(set(_people_frames(contents, roles)))
    candidates = [frames.base] if frames.base else tree.bases(None)
    for frame in seen:
        base = frames.base or next((base for base in candidates if tree.chain(base, frame) is not None), "")
        base = base or next((frame for name in BASES if is_named(frame, name)), "")
        chain = tree.chain(base, frame) if base else None
        if frame_given:
            frames.given.add(frame)
        elif chain is None:
            frames.unconnected.add(frame)
        elif chain:
            frames.people[frame] = chain
            frames.base = base
    if roles.bodies:
        _add_bodies(contents, frames, candidates, skeletons=skeletons, frame_given=frame_given)
    contents.warnings += _warnings(contents, frames)
    return frames


def _connect_bases(contents: Contents, roles: Roles, named: set[str]) -> None:
    """Add the transform between the two base frames of a UR if the bag lacks it: `base_link` is `base` turned by pi.

    So says the page "Robot Frames" of Universal Robots' ROS description; `base` is that of the controller.
    """
    tree, (base, turned) = contents.transforms, BASES[:2]
    parts = contents.tracks[str(roles.joints)].parts if roles.joints in contents.tracks else []
    is_ur = any("shoulder_pan_joint" in part.value.names for part in parts if isinstance(part.value, JointStates))
    if is_ur and {base, turned} <= {*named, *tree.frames()} and tree.chain(base, turned) is None:
        half_turn = np.array([[0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0]])
        if base not in tree.links:
            tree.links[base] = FrameTransforms(turned, base, pose=half_turn, times=np.zeros(1))
        else:
            tree.links.setdefault(turned, FrameTransforms(base, turned, pose=half_turn, times=np.zeros(1)))
        contents.warnings.append(
            f"no transforms between {base!r} and {turned!r}: taken as a half turn about z, as on a UR"
        )


def _people_frames(contents: Contents, roles: Roles) -> Iterator[str]:
    for topic in roles.people:
        for part in contents.tracks[topic].parts if topic in contents.tracks else []:
            entries = part.value.frames if isinstance(part.value, Persons) else ()
            yield from (frame.strip("/") for frame in (part.frame, *entries) if frame)


def _add_bodies(
    contents: Contents, frames: Frames, candidates: list[str], *, skeletons: bool, frame_given: bool
) -> None:
    tree = contents.transforms
    for person, body in tree.bodies().items():
        begin = "" if frame_given else next((base for base in candidates if tree.chain(base, body)), "")
        frames.base = frames.base or begin
        if not begin:
            begin = tree.root(body)
            (frames.given if frame_given else frames.unconnected).add(begin)
        frames.bodies.append(TransformedBody(person, tree.chain(begin, body) or []))
        for child in sorted(tree.links) if skeletons else []:
            joint = of_human(child, person)
            if joint and (chain := tree.chain(begin, child)):
                frames.bodies.append(TransformedBody(person, chain, joint))


def _warnings(contents: Contents, frames: Frames) -> Iterator[str]:
    if frames.unconnected:
        names = ", ".join(repr(name) for name in sorted(frames.unconnected))
        of = f"the robot's base ({frames.base!r})" if frames.base else "the robot's base"
        yield f"no transforms from {of} to the people: they are in frame {names}; give frame in cell.toml"
    used = {link.transforms.child for chain in (frames.tool, frames.tcp, *frames.people.values()) for link in chain}
    used |= {link.transforms.child for body in frames.bodies for link in body.chain}
    for child in sorted(used & set(contents.transforms.several_parents)):
        taken = contents.transforms.links[child].parent
        parents = ", ".join(repr(name) for name in contents.transforms.several_parents[child])
        yield f"frame {child!r} has several parents ({parents}): {taken!r}, the most frequent, is used"


def described(chain: list[Link], begin: str) -> str:
    """Return a chain as text: `base <- world <- camera`."""
    return " <- ".join([begin, *map(str, chain)])


def unknown(places: Array) -> int:
    """Return the number of unknown positions, shape (..., 3)."""
    return int(np.count_nonzero(np.isnan(places[..., 0])))
