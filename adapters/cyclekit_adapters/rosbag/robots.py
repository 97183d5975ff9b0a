"""Which topics are of one robot, where a bag holds several.

The drivers of several robots write the same topics, each in a namespace of its own. A pose of one with the scaling of
another is no robot, so one is chosen: by a topic that the cell file names, else by the only TCP pose. Topics below no
robot's namespace (people, `/joint_states` of all) are everybody's. What the topics mean is the business of `roles`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import TYPE_CHECKING

from cyclekit.errors import LogError

if TYPE_CHECKING:
    from pathlib import Path

Space = tuple[str, ...]


def parts(topic: str) -> Space:
    """Return the names in a topic: `/left/joint_states` is ("left", "joint_states")."""
    return tuple(topic.strip("/").split("/"))


def spaces(topics: Iterable[str], quantity: Callable[[str], str | None]) -> set[Space]:
    """Return the namespaces of the robots: those in which one quantity stands that stands in others too.

    Args:
        topics: Those of the bag.
        quantity: The end of a topic's name that says what it tells of a robot; None if it tells nothing of one.
    """
    found: dict[str, set[Space]] = {}
    for topic in topics:
        if end := quantity(topic):
            found.setdefault(end, set()).add(parts(topic)[: -len(parts(end))])
    return set().union(*(where for where in found.values() if len(where) > 1))


def space_of(topic: str, robots: Iterable[Space]) -> Space | None:
    """Return the namespace that a topic lies in, the innermost of them; None if it lies in none."""
    names = parts(topic)
    return max((space for space in robots if names[: len(space)] == space), key=len, default=None)


def of_one_robot(path: Path, types: Mapping[str, str], robots: set[Space], anchors: Iterable[str]) -> dict[str, str]:
    """Return the topics of the robot that the anchors belong to, and those of no robot.

    Args:
        path: The bag, for messages.
        types: Message type of each topic.
        robots: Namespaces of the robots; nothing is left out where there are fewer than two.
        anchors: Topics of the robot that is meant, the surest first.

    Raises:
        LogError: There are several robots, and no anchor tells which is meant.
    """
    if len(robots) < 2:
        return dict(types)
    ours = next((space for topic in anchors if (space := space_of(topic, robots)) is not None), None)
    if ours is None:
        names = ", ".join(sorted("/" + "/".join(space) for space in robots))
        cure = "Name one robot's topic in [sources.map] of cell.toml, as tcp or scaling: the others follow."
        raise LogError(path, f"it holds {len(robots)} robots, in the namespaces {names}", cure=cure)
    return {topic: kind for topic, kind in types.items() if space_of(topic, robots) in (ours, None)}
