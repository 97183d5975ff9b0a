"""Detection of tables of body landmarks in images, in the formats of the many scripts that write them.

MediaPipe defines no table format, so each script has its own: a column per landmark and coordinate (`x0`, `L0_x`,
`LEFT_SHOULDER_x`, `nose_visibility`), a row per landmark (`frame, landmark, x, y, z, visibility`), tuples in a cell, or
bare numbers. They are detected by features that only MediaPipe has: its names, 33 numbered landmarks, a visibility,
depths relative to the hips. Skeletons of depth cameras have none of these. The adapter `mediapipe` handles such tables.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np

from cyclekit_adapters.text.text_blocks import HEAD_BYTES
from cyclekit_adapters.text.text_layout import delimiter_of, fields_of
from cyclekit_adapters.tracking.landmark_values import (
    LANDMARKS,
    are_nameless_landmarks,
    as_numbers,
    depths_around_hips,
    in_picture,
    is_pose,
    may_be_nameless,
)

OWN_NAMES = (
    *("lefteyeinner", "righteyeinner", "lefteyeouter", "righteyeouter", "mouthleft", "mouthright"),
    *("leftfootindex", "rightfootindex", "leftpinky", "rightpinky"),
)
"""Names that only MediaPipe's pose has, without separators."""
_WRITTEN_OUT = re.compile(
    r"""\b(?:Normalized)?Landmark\(x=-?\d|"\[?\{\s*(?:'|"")x(?:'|"")\s*:[^}]+(?:visibility|presence)"""
    r"""|x: -?[\d.e-]+\s+y: -?[\d.e-]+\s+z: -?[\d.e-]+\s+(?:visibility|presence):"""
)
"""Cells with text forms of Python objects: MediaPipe objects, dictionaries, multi-line messages."""
_WHOLE = re.compile(r"[^a-z0-9]+")
_PART = re.compile(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+|\d+")
_X = re.compile(r"(?<![A-Za-z])[xX](?![A-Za-z])|(?<=[a-z0-9])X(?![A-Za-z])")
_OWN_WORDS = ("landmark", "lmk", "mouth", "inner", "foot")
_LANDMARK = {"landmark", "landmarks", "lm", "lmk"}
_FILLER = {"pose", "world", "keypoint", "kp", "joint", "point", "pt", "norm", "normalized", "image", "body"}
_FILLER |= {"m", "px", "pixel", "position", "pos", "coord", "coordinate", *_LANDMARK}
_SEEN = {"visibility": "v", "vis": "v", "v": "v", "presence": "v"}
_ABBREVIATED = {"l", "p", "k"}  # `L0_x`
_HUMAN = {"nose", "hip", "knee", "ankle", "eye", "ear", "heel", "foot", "mouth"}
_BODY = {"shoulder", "elbow", "wrist", *_HUMAN}  # robot arms also have the first three
_WHICH = _LANDMARK | {"keypoint", "kp", "joint", "bodypart", "part", "point", "name", "id", "index", "idx"}
_COUNTS = {LANDMARKS, 75, 468, 478, 501, 543, 553}  # pose; with hands; face; pose and face; all of them
_FEW = 2
_BRACKETS, _LISTS = ("[", "("), ('"[', '"(', "\t[", "\t(")
_WORDS = ("Landmark(", "visibility", "presence")
_LINES, _CELLS = 4 * LANDMARKS, 40


@lru_cache(maxsize=16)  # several adapters ask this for each file
def landmarks_in(head: str) -> str:
    """Return the evidence that a text starts a table of landmarks in an image; "" if there is none."""
    if any(word in head for word in _WORDS) and _WRITTEN_OUT.search(head):
        return "landmarks are written out in its cells"
    lines = head.split("\n", _LINES + 1)[: _LINES + 1]
    lines = lines[:-1] if len(lines) > _LINES or len(head) >= HEAD_BYTES // 2 else lines  # it may be incomplete
    lines = [line.rstrip("\r") for line in lines if line.strip() and not line.startswith("#")] or [""]
    delimiter = delimiter_of(lines[0], ",;\t ")
    delimiter = "\\s+" if delimiter == " " else delimiter
    first = _cells(lines[0], delimiter)
    if any(mark in head for mark in _LISTS):
        rows = [_cells(line, delimiter) for line in lines[:3]]
        if any(sum(cell[:1] in _BRACKETS for cell in row if cell) >= LANDMARKS for row in rows[1:]):
            return f"its rows are {LANDMARKS} lists each"
        if _read(first).says_landmark and any(cell[:1] in _BRACKETS for row in rows[1:2] for cell in row if cell):
            return "its cells are lists of landmarks"
    if not _has_names(first):
        fits = may_be_nameless(len(first), len(lines))
        return "its rows are landmarks without names" if fits and _are_nameless(lines, delimiter) else ""
    plain = lines[0].lower()
    if not any(word in plain for word in _OWN_WORDS) and not ("x" in plain and _X.search(lines[0])):
        return ""
    table = _read(first)
    reason = _own_names(first) or _numbered(table)
    if reason or not (table.named or {"x", "y"}.issubset(table.plain)):
        return reason
    rows = [_cells(line, delimiter) for line in lines]
    return _named(table, rows[1:]) or _one_a_row(table, rows)


def _cells(line: str, delimiter: str) -> list[str]:
    return [cell.strip() for cell in fields_of(line, delimiter)]


def _are_nameless(lines: list[str], delimiter: str) -> bool:
    return are_nameless_landmarks([_cells(line, delimiter) for line in lines])


def _has_names(cells: list[str]) -> bool:
    """Return whether a row is a header; rows of numbers may also hold a label."""
    words = sum(bool(cell) and not _is_number(cell) for cell in cells[:_CELLS])
    return words > len(cells[:_CELLS]) // 4


def _is_number(cell: str) -> bool:
    try:
        return isinstance(float(cell), float)
    except ValueError:
        return False


@dataclass
class _Table:
    """Landmark and coordinate of each column of a header.

    Attributes:
        numbered: Coordinate (x, y, z, or v for visibility) -> number of the landmark -> column.
        named: Coordinate -> name of the landmark -> column.
        plain: Coordinate -> column, if one column holds it for all landmarks.
        which: Columns that may hold the landmark of a row.
        says_landmark: Number of columns with the word landmark.
        says_point: Number of columns with the word joint or keypoint.
        says_visibility: Number of columns with the word visibility or presence.
    """

    numbered: dict[str, dict[int, int]] = field(default_factory=dict)
    named: dict[str, dict[str, int]] = field(default_factory=dict)
    plain: dict[str, int] = field(default_factory=dict)
    which: list[int] = field(default_factory=list)
    says_landmark: int = 0
    says_point: int = 0
    says_visibility: int = 0


def _read(header: list[str]) -> _Table:
    table = _Table()
    for at, cell in enumerate(header):
        words = [word.lower() for word in _PART.findall(cell)]
        table.says_landmark += bool(_LANDMARK.intersection(words))
        table.says_point += bool({"joint", "keypoint", "kp"}.intersection(words))
        table.says_visibility += bool({"visibility", "presence"}.intersection(words))
        axes = [word for word in words if word in ("x", "y", "z") or word in _SEEN]
        if len(axes) != 1:
            if _WHICH.intersection(words):
                table.which.append(at)
            continue
        axis = _SEEN.get(axes[0], axes[0])
        rest = [word for word in words if word != axes[0] and word not in _FILLER]
        numbers = [int(word) for word in rest if word.isdecimal() and len(word) <= 3]
        names = sorted(word for word in rest if not word.isdecimal())
        if not rest:
            table.plain.setdefault(axis, at)
        elif len(numbers) == 1 and _ABBREVIATED.issuperset(names):
            table.numbered.setdefault(axis, {}).setdefault(numbers[0], at)
        elif names:
            table.named.setdefault(axis, {}).setdefault("_".join(names), at)
    return table


def _own_names(header: list[str]) -> str:
    plain = [_WHOLE.sub("", cell.lower()) for cell in header]
    found = [cell for cell, text in zip(header, plain, strict=True) if any(name in text for name in OWN_NAMES)]
    return f"its columns have MediaPipe's names ({found[0][:40]})" if len(found) >= _FEW else ""


def _numbered(table: _Table) -> str:
    """Return the evidence in columns such as `x0, y0, z0, v0` and `landmark_0_x`."""
    numbers = set(table.numbered.get("x", {})) & set(table.numbered.get("y", {}))
    seen = numbers & set(table.numbered.get("v", {}))
    if len(numbers) < _FEW:
        return ""
    whole = numbers in (set(range(len(numbers))), set(range(1, len(numbers) + 1)))
    sure = (whole and len(numbers) in _COUNTS) or len(seen) >= LANDMARKS
    if sure or table.says_landmark >= _FEW or (len(seen) >= _FEW and table.says_visibility >= _FEW):
        return f"its columns are {len(numbers)} numbered landmarks"
    flat = not table.numbered.get("z") and not table.named.get("z") and "z" not in table.plain
    if flat and len(numbers) > _FEW and table.says_point >= 2 * len(numbers):
        return f"its columns are {len(numbers)} points of a body in a picture, without a depth"
    return ""


def _named(table: _Table, rows: list[list[str]]) -> str:
    """Return the evidence in columns such as `nose_x` and `LEFT_HIP_visibility`, which other skeletons also have."""
    flat = {name for name in table.named.get("x", {}) if _BODY.intersection(name.split("_"))}
    flat &= set(table.named.get("y", {}))
    if len(flat) < _FEW:
        return ""
    shown = f"its columns are {len(flat)} points of a body"
    if len(flat & set(table.named.get("v", {}))) >= _FEW:
        return f"{shown} with a visibility"
    if not table.named.get("z"):
        human = any(_HUMAN.intersection(name.split("_")) for name in flat)
        return f"{shown} in a picture, without a depth" if human else ""
    left, right = (_hip(table.named["z"], side) for side in ("left", "right"))
    if left is not None and right is not None:
        around = depths_around_hips(*as_numbers(rows, [left, right]).T)
        return f"{shown} with a depth relative to the hips" if around else ""
    nose, shoulder = "nose", next((name for name in flat if "shoulder" in name), "")
    if nose not in flat or nose not in table.named["z"] or not shoulder:
        return ""
    heights, depths = table.named["y"], table.named["z"]
    above, below, depth = as_numbers(rows, [heights[nose], heights[shoulder], depths[nose]]).T
    front = bool(len(depth)) and bool(np.mean(depth < 0.0) > 0.5)  # a depth camera sees nothing behind itself
    return f"{shown} in fractions of a picture" if front and in_picture(above, below) else ""


def _hip(columns: dict[str, int], side: str) -> int | None:
    """Return the column of the left or right hip, in its usual spellings (`left_hip`, `HipLeft`, `l_hip`, `LHip`)."""
    found = (columns.get("_".join(sorted(name))) for name in ([side, "hip"], [side[0], "hip"], [f"{side[0]}hip"]))
    return next((at for at in found if at is not None), None)


def _one_a_row(table: _Table, rows: list[list[str]]) -> str:
    """Return the evidence in `frame, landmark, x, y, z, visibility`, a row per landmark."""
    if "x" not in table.plain or "y" not in table.plain:
        return ""
    header, rows = rows[0], [row for row in rows[1:] if len(row) >= len(rows[0])]
    tells = [at for at in table.which if _tells_landmark(rows, at)]
    shown = f"its rows are single landmarks ({', '.join(header)[:60]})"
    if table.says_landmark and ("v" in table.plain or tells or not table.which):
        return shown
    if any(_own_names([row[at] for row in rows]) for at in table.which):
        return shown
    if tells and table.says_visibility:
        return shown
    axes = [table.plain[axis] for axis in "xyz" if axis in table.plain]
    whole = [at for at in tells if [row[at] for row in rows[:LANDMARKS]] == [str(i) for i in range(LANDMARKS)]]
    if not (whole or (not table.which and len(axes) == len("xyz"))):
        return ""
    points = as_numbers(rows[: len(rows) // LANDMARKS * LANDMARKS], axes)
    return shown if is_pose(points.reshape(-1, LANDMARKS, len(axes))) else ""


def _tells_landmark(rows: list[list[str]], at: int) -> bool:
    """Return whether a column names body points, or numbers them, frame after frame."""
    cells = [row[at] for row in rows]
    named = sum(bool(_BODY.intersection(word.lower() for word in _PART.findall(cell))) for cell in cells)
    if named >= max(_FEW, len(cells) // 4):
        return True
    if len(cells) < _FEW or not all(cell.isdecimal() and len(cell) <= 3 for cell in cells):
        return False
    numbers = np.array([int(cell) for cell in cells])
    again = numbers[1:] == numbers[0]
    return bool(((np.diff(numbers) > 0) | again).all() and numbers.max() > numbers[0] + _FEW)
