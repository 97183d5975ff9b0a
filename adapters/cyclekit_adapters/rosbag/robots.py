"""Selection of one robot's topics in a bag with several robots.

The drivers of several robots write the same topics, each in its own namespace. Topics of different robots must not be
mixed, so one robot is chosen: by a topic given in the cell file, else by the only TCP pose. Topics outside of the
robots' namespaces (people, a common `/joint_states`) are kept. `roles` interprets the topics.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import TYPE_CHECKING

from cyclekit.errors import LogError

if TYPE_CHECKING:
    from pathlib import Path

Space = tuple[str, ...]


def parts(topic: str) -> Space:
    """Return the names in a topic: `/left/joint_states` gives ("left", "joint_states")."""
    return tuple(topic.strip("/").split("/"))


def spaces(topics: Iterable[str], quantity: Callable[[str], str | None]) -> set[Space]:
    """Return the namespaces of the robots: those with a quantity that also occurs in another namespace.

    Args:
        topics: Topics of the bag.
        quantity: Function from a topic to the ending that names a quantity of a robot; None for other topics.
    """
    found: dict[str, set[Space]] = {}
    for topic in topics:
        if end := quantity(topic):
            found.setdefault(end, set()).add(parts(topic)[: -len(parts(end))])
    return set().union(*(where for where in found.values() if len(where) > 1))


def space_of(topic: str, robots: Iterable[Space]) -> Space | None:
    """Return the innermost of the namespaces that contains a topic; None if there is none."""
    names = parts(topic)
    return max((space for space in robots if names[: len(space)] == space), key=len, default=None)


def of_one_robot(path: Path, types: Mapping[str, str], robots: set[Space], anchors: Iterable[str]) -> dict[str, str]:
    """Return the topics of the robot that the anchors belong to, and those of no robot.

    Args:
        path: The bag, for messages.
        types: Message type of each topic.
        robots: Namespaces of the robots; with fewer than two, all topics are returned.
        anchors: Topics of the wanted robot, the most certain first.

    Raises:
        LogError: There are several robots, and no anchor identifies one.
    """
    if len(robots) < 2:
        return dict(types)
    ours = next((space for topic in anchors if (space := space_of(topic, robots)) is not None), None)
    if ours is None:
        names = ", ".join(sorted("/" + "/".join(space) for space in robots))
        cure = "Name one robot's topic in [sources.map] of cell.toml, as tcp or scaling: the others follow."
        raise LogError(path, f"it holds {len(robots)} robots, in the namespaces {names}", cure=cure)
    return {topic: kind for topic, kind in types.items() if space_of(topic, robots) in (ours, None)}
