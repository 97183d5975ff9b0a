"""Selection of the person among the markers of an optical tracker, and the person's position.

The position is the centre of the visible pelvis markers, or without known pelvis markers the centre of all markers of
the subject. The subject is the part of a marker's name before the colon. If any subject wears pelvis markers, subjects
without them are objects. The cell file can give a subject, one marker, or a list of markers.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Literal

import numpy as np
import polars as pl

from cyclekit.adapter import Recording
from cyclekit.errors import LogError, nearest
from cyclekit.schema import PEOPLE, conform
from cyclekit_adapters.mapped.source_map import split_names, words
from cyclekit_adapters.tracking.joints import all_joints, joint_rows

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from cyclekit.adapter import ReadOptions
    from cyclekit_adapters.text.delimited import TextRows
    from cyclekit_adapters.tracking.person_counts import PersonCounts

_SIDE = "(?:l|r|left|right)"
_PELVIS = re.compile(
    # Anterior and posterior superior iliac spines: LASI, ASISr, L_PSIS, R.ASIS, `r asis` (BTS), L_IAS and RIPS (ISB).
    rf"(?:{_SIDE}_?)?(?:asis?|psis?|ias)(?:_?{_SIDE})?|{_SIDE}_ips|ips_{_SIDE}"
    r"|(?:v_)?sacr(?:um|al)?|s1"
    # Waist and hips, of trackers and of keypoints (RHip, left_hip, CHip, MidHip), and the joint centres (LHJC).
    rf"|(?:{_SIDE}_?)?(?:waist|pelvis|hips?|hjc)(?:_?{_SIDE})?(?:_?(?:front|back|[fb]))?"
    r"|(?:c|mid|center|centre)_?hips?|hips?_?(?:center|centre)"
)
_IPS = re.compile("[LR]IPS")  # upper case only: lips are not part of the pelvis
_APART = re.compile(r"[\s._-]+")
_ALONE = "person"
_EARTH_M = 1e7  # a marker farther away is a garbled number


@dataclass(frozen=True)
class People:
    """People among the markers.

    Attributes:
        tracks: Person -> markers whose centre is the position.
        point: Description of that centre.
        things: Subjects that are not people.
        worn: Person -> all labelled markers of the person, the joints of a skeleton.
    """

    tracks: dict[str, list[int]]
    point: str
    things: tuple[str, ...] = ()
    worn: dict[str, list[int]] = field(default_factory=dict)

    def used(self, *, skeletons: bool) -> list[int]:
        """Return the needed markers, ascending."""
        tracks = [*self.tracks.values(), *(self.worn.values() if skeletons else ())]
        return sorted({index for members in tracks for index in members})

    def among(self, used: Sequence[int]) -> People:
        """Return the same people with markers numbered by their position in `used`."""
        at = {index: place for place, index in enumerate(used)}
        tracks = {who: [at[index] for index in members] for who, members in self.tracks.items()}
        worn = {who: [at[index] for index in members if index in at] for who, members in self.worn.items()}
        return replace(self, tracks=tracks, worn=worn)


def marker_words(options: ReadOptions, adapter: str, more: Mapping[str, Sequence[str]] | None = None) -> dict[str, str]:
    """Return the checked words of `[sources.map]`: `up` and the adapter's own keys `more`, without `markers`.

    Raises:
        ConfigError: A key or a word is unknown.
    """
    _, rest = split_names(options, adapter, "markers")
    return words(replace(options, map=rest), adapter, {"up": ("y", "z"), "markers": (), **(more or {})})


def choose_people(path: Path, names: Sequence[str], options: ReadOptions, adapter: str) -> People:
    """Find the people among markers called `names`.

    Raises:
        LogError: `options` names a body or marker that is missing, or there are no markers.
        ConfigError: `markers` of the map is not a list of names.
    """
    wanted, _ = split_names(options, adapter, "markers")
    subjects = _subjects(names)
    if wanted:
        named = {options.body or _ALONE: [_find(path, names, name) for name in wanted]}
        return People(named, "markers named", worn=named)
    if options.body is not None:
        if options.body in subjects:
            members = subjects[options.body]
            pelvis = [index for index in members if is_pelvis(names[index])]
            worn = {options.body: _labelled(members, names)}
            return People({options.body: pelvis or members}, _point(bool(pelvis)), worn=worn)
        return People({options.body: [_find(path, (*names, *subjects), options.body)]}, "the marker named")
    if not subjects:
        raise LogError(path, "no positions: it has no markers", cure="Export the trajectories of the markers.")
    hips = {who: [i for i in members if is_pelvis(names[i])] for who, members in subjects.items()}
    found = {who: members for who, members in hips.items() if members}
    things = tuple(who for who in subjects if found and who not in found)
    worn = {who: _labelled(subjects[who], names) for who in found or subjects}
    return People(found or subjects, _point(bool(found)), things, worn)


def _point(hips: bool) -> str:
    return "middle of the pelvis markers seen" if hips else "middle of all markers seen"


def is_pelvis(name: str) -> bool:
    """Return whether a marker, with or without subject, belongs to the pelvis."""
    own = name.rpartition(":")[2].strip()
    plain = _APART.sub("_", own.lower()).removesuffix("_study")  # suffix of OpenCap and Pose2Sim for inferred markers
    return _PELVIS.fullmatch(plain) is not None or _IPS.fullmatch(own) is not None


def _subjects(names: Sequence[str]) -> dict[str, list[int]]:
    found: dict[str, list[int]] = {}
    for index, name in enumerate(names):
        subject, colon, _ = name.rpartition(":")
        found.setdefault(subject.strip() if colon else _ALONE, []).append(index)
    labelled = {who: members for who, members in found.items() if who != _ALONE}
    loose = [i for i in found.get(_ALONE, []) if not names[i].startswith("*")]
    if labelled and not any(is_pelvis(names[i]) for i in loose):
        return labelled  # markers without a subject, next to named subjects
    return found


def _labelled(members: Sequence[int], names: Sequence[str]) -> list[int]:
    return [index for index in members if not names[index].rpartition(":")[2].startswith("*")]


def _find(path: Path, names: Sequence[str], name: str) -> int:
    if name in names:
        return list(names).index(name)
    short = [index for index, known in enumerate(names) if known.rpartition(":")[2] == name]
    if len(short) == 1:
        return short[0]
    cure = f"In the file: {', '.join(names[:40])}{', ...' if len(names) > 40 else ''}."
    raise LogError(path, f"no body or marker {name!r}", nearest=nearest(name, names), cure=cure)


def people_table(people: People, points_m: NDArray[np.float64], t_s: pl.Series, source_row: pl.Series) -> pl.DataFrame:
    """Return the rows of PEOPLE, ordered by time: the centre of the visible markers, null if none is visible.

    Args:
        people: Markers of each person.
        points_m: Marker positions, shape (T, M, 3), m, NaN = not seen.
        t_s: Times, shape (T,), s.
        source_row: Rows, shape (T,).
    """
    tracks = []
    for person, members in people.tracks.items():
        seen: NDArray[np.bool_] = np.all(np.abs(points_m[:, members]) < _EARTH_M, axis=2)  # NaN compares false
        count = seen.sum(axis=1)
        total = np.where(seen[:, :, None], points_m[:, members], 0.0).sum(axis=1)
        middle = np.full((len(t_s), 3), np.nan)
        middle[count > 0] = total[count > 0] / count[count > 0, None]
        axes = {f"{axis}_m": pl.Series(middle[:, i]).fill_nan(None) for i, axis in enumerate("xyz")}
        frame = pl.DataFrame({"t_s": t_s, **axes, "source_row": source_row})
        tracks.append(conform(frame.with_columns(person=pl.lit(person)), PEOPLE))
    table = pl.concat(tracks)
    return table.sort("source_row", maintain_order=True) if len(tracks) > 1 else table


def skeleton_table(
    people: People, names: Sequence[str], points_m: NDArray[np.float64], t_s: pl.Series, source_row: pl.Series
) -> pl.DataFrame:
    """Return the rows of SKELETONS: labelled markers of each person, with names without the subject.

    Args:
        people: Markers of each person.
        names: M names.
        points_m: As in `people_table`.
        t_s: Times, shape (T,), s.
        source_row: Rows, shape (T,).
    """
    tables = []
    for person, members in people.worn.items():
        joints = [names[i].rpartition(":")[2].strip().lower() for i in members]
        points = np.where(np.abs(points_m[:, members]) < _EARTH_M, points_m[:, members], np.nan)
        tables.append(joint_rows(t_s, person, joints, points, source_row))
    return all_joints(tables)


def recording_of(
    people: People,
    names: Sequence[str],
    points_m: NDArray[np.float64],
    t_s: pl.Series,
    rows: TextRows,
    seen: PersonCounts,
    *,
    options: ReadOptions,
    up: Literal["y", "z"],
) -> Recording:
    """Return one part of a table of markers as a recording, and add it to `seen`.

    Args:
        people: Markers of each person.
        names: M names.
        points_m: As in `people_table`.
        t_s: Times of the tracker's clock, shape (T,), s.
        rows: Lines of the file, with `source_row`.
        seen: Counts of the file so far.
        options: Whether skeletons are stored.
        up: Vertical axis.
    """
    table = people_table(people, points_m, t_s, rows.frame["source_row"])
    seen.add(table)
    seen.clock(t_s)
    skeletons = skeleton_table(people, names, points_m, t_s, rows.frame["source_row"]) if options.skeletons else None
    return Recording(
        people=table,
        skeletons=skeletons,
        clock="relative",
        up=up,
        rows_are="line",
        rows_read=rows.rows_read,
        set_aside=rows.set_aside,
    )


def marker_warnings(people: People, seen: PersonCounts, flange: str | None = None) -> list[str]:
    """Return warnings about the choice of markers, and the number of frames in which people were hidden."""
    found = []
    tracked = [name for name in people.tracks if name != flange]
    if len(tracked) > 1:
        found.append(f"{len(tracked)} bodies tracked ({', '.join(tracked)}): name the operator with `body`")
    if "all markers" in people.point:
        found.append(
            "no marker has a known pelvis name: the person is the middle of all markers; set `body` or `markers`"
        )
    if any(len(members) > 1 for members in people.tracks.values()):
        found.append("the person's position is the middle of the visible markers; it shifts when one is hidden")
    return found + seen.unseen_messages(flange)


def marker_facts(people: People, names: Sequence[str]) -> dict[str, str]:
    """Return facts about the tracked persons and markers, to display."""
    facts = {"tracked": ", ".join(people.tracks), "point": people.point}
    facts["markers_used"] = ", ".join(names[i] for members in people.tracks.values() for i in members)
    if people.things:
        facts["not_people"] = ", ".join(people.things)
    facts["names_in_file"] = ", ".join(names)
    return facts
