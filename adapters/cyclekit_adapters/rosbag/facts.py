"""Facts of a bag, to display: use, clock and frame of each topic."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING

from cyclekit.text.numbers import given
from cyclekit_adapters.rosbag.clocks import EPOCH_S
from cyclekit_adapters.rosbag.frames import described

if TYPE_CHECKING:
    from cyclekit_adapters.rosbag.container import Bag
    from cyclekit_adapters.rosbag.frames import Frames
    from cyclekit_adapters.rosbag.roles import Factor, Roles
    from cyclekit_adapters.rosbag.tracks import Contents

_HOW = {"header": "header stamp", "receive": "receive time", "own-clock": "header stamp on the recorder's clock"}


def facts_of(bag: Bag, roles: Roles, contents: Contents, frames: Frames, *, is_simulated: bool) -> dict[str, str]:
    """Return the facts of a bag by name."""
    unused = sorted(set(bag.topics) - roles.topics())
    checked = {"checksum": "CRC-32 of every chunk, verified"} if bag.has_checksums() else {}
    return {
        **checked,
        **_times(contents),
        "simulated_time": _simulated(contents, is_simulated=is_simulated),
        **_frames(roles, contents, frames),
        "joints": roles.joints or "none",
        "speed_scaling": " * ".join(map(_scale, roles.scaling)) or "not recorded",
        "program_running": roles.running or "not recorded",
        "people": ", ".join([*roles.people, *(["body_<id> in transforms"] if roles.bodies else [])]) or "none",
        "events": ", ".join(roles.events) or "none",
        **{f"layout of {topic}": reason for topic, reason in sorted(bag.layouts.items())},
        **_rows(bag, roles, contents),
        "skipped_topics": ", ".join(unused) or "none",
    }


def _simulated(contents: Contents, *, is_simulated: bool) -> str:
    begin = min((float(track.receive_s.min()) for track in contents.tracks.values()), default=EPOCH_S)
    if is_simulated:
        return "yes"
    return "likely: the recorder's clock does not count from 1970" if begin < EPOCH_S else "no sign of it"


def _scale(factor: Factor) -> str:
    return f"{factor.topic} / {given(factor.full)}"


def _times(contents: Contents) -> dict[str, str]:
    """Return facts about the time used, for the whole bag and for every topic."""
    chosen = contents.times.chosen
    ways = Counter(_HOW[one.how] for one in chosen.values())
    reasons = dict.fromkeys(one.why for one in chosen.values() if one.how == "receive")
    topics_of = {reason: sorted(name for name in chosen if chosen[name].why == reason) for reason in reasons}
    why = [f"{reason} on {', '.join(topics)}" for reason, topics in topics_of.items()]
    if contents.times.own:
        why = ["the header stamps share one clock, which is not the recorder's"]
    return {
        "time": " and ".join(sorted(ways)) or "none",
        "time_because": "; ".join(why) or "every topic in use has a header time",
        **{f"time of {name}": one.fact() for name, one in sorted(chosen.items())},
    }


def _frames(roles: Roles, contents: Contents, frames: Frames) -> dict[str, str]:
    by_topic = {topic: contents.frame_of(topic) for topic in sorted(contents.tracks)}
    named = ", ".join(f"{topic}: {frame}" for topic, frame in by_topic.items() if frame)
    chains = [described(chain, frames.base) for chain in frames.people.values()]
    whole = [body.chain for body in frames.bodies if body.chain and not body.joint]
    chains += [described(chain, chain[0].transforms.parent) for chain in whole]
    others = sorted(frames.unconnected | frames.given)
    whose = "; ".join([*(f"transforms {chain}" for chain in chains), *others]) or "that of the robot's base"
    return {
        "tcp": roles.tcp or (f"transforms {described(frames.tool, frames.base)}" if frames.tool else "none"),
        "frames": named or "none",
        "base_frame": frames.base or "unknown",
        **({"people_frame": whose} if roles.people or roles.bodies else {}),
    }


def _rows(bag: Bag, roles: Roles, contents: Contents) -> dict[str, str]:
    """Return the unit of `source_row` and, for a recording of several files, the file of each message."""
    found = {f"rows of {table}": f"messages of {topics}" for table, topics in contents.rows_of.items() if topics}
    if len(bag.files) < 2:
        return {**found, "message_index": "within its topic, by receive time, from 0"}
    found["message_index"] = "within its topic from 0, file by file in the order of time"
    for topic in sorted(roles.topics() & set(bag.topics)):
        begin, ranges = 0, []
        for name, count in bag.parts(topic):
            ranges.append(f"{name} {begin} to {begin + count - 1}")
            begin += count
        if ranges:
            found[f"messages of {topic}"] = ", ".join(ranges)
    return found
