"""C3D, the binary motion-capture file that Vicon, Qualisys, Motive and others write.

A person's position is the centre of the visible pelvis markers, by subject (`Subject:Marker`). A marker with a negative
residual or NaN was not seen. `POINT:UNITS` gives the length unit. The vertical axis is given by `POINT:Y_SCREEN`, else
by heads above feet, else it is Z. The clock is the trial's: frame / `POINT:RATE`, with the first frame of the capture
at (first - 1) / rate; the file holds no time of day. Analog channels are ignored, and so are points that the file lists
as angles, forces, moments, powers or scalars. Skeletons, if requested, hold the subject's labelled markers.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal, cast

import polars as pl

from cyclekit.adapter import Adapter, ReadOptions, Recording
from cyclekit.errors import DamagedLog, nearest
from cyclekit.text.numbers import given
from cyclekit_adapters.text.text_rows import SET_ASIDE
from cyclekit_adapters.tracking.c3d_file import C3dFile, is_c3d, read_c3d
from cyclekit_adapters.tracking.length_unit import METRES, unit_of
from cyclekit_adapters.tracking.markers import (
    choose_people,
    marker_facts,
    marker_warnings,
    marker_words,
    people_table,
    skeleton_table,
)
from cyclekit_adapters.tracking.person_counts import PersonCounts
from cyclekit_adapters.tracking.vertical_axis import FRAMES_USED, vertical_axis

if TYPE_CHECKING:
    from pathlib import Path

    import numpy as np
    from numpy.typing import NDArray

_NO_PLACES = ("ANGLES", "FORCES", "MOMENTS", "POWERS", "SCALARS")


class _C3d:
    def recognises(self, path: Path) -> bool:
        return is_c3d(path)

    def read(self, path: Path, options: ReadOptions) -> Recording:
        up = marker_words(options, "C3D").get("up")
        log = read_c3d(path)
        metres, unit = _metres(path, log)
        names, places = _markers(log)
        people = choose_people(path, names, options, "C3D")
        rows = pl.int_range(len(places), dtype=pl.Int64, eager=True)
        t_s = ((log.first_frame - 1 + rows) / log.rate_hz).cast(pl.Float64)
        places = places * metres
        table = people_table(people, places, t_s, rows)
        seen = PersonCounts()
        seen.add(table)
        messages = marker_warnings(people, seen, options.flange)
        cut = log.frames_stated - len(places)
        if cut:
            messages.append(f"the file is cut: {cut} of {log.frames_stated} frames are missing at its end")
        if log.by_size:
            messages.append(
                f"its counter of frames is at its bound: {len(places)} are read by the size of the file; "
                "TRIAL:ACTUAL_END_FIELD would tell their number"
            )
        axis, evidence = (up, "from the cell file") if up else _up(log, names, places, messages)
        return Recording(
            people=table,
            skeletons=skeleton_table(people, names, places, t_s, rows) if options.skeletons else None,
            clock="relative",
            up=cast('Literal["y", "z"]', axis),
            rows_are="frame",
            rows_read=len(rows),
            set_aside=pl.DataFrame(schema=SET_ASIDE),
            warnings=tuple(messages),
            facts={
                "rate_hz": given(log.rate_hz),
                "unit": unit,
                "up": f"{axis}, {evidence}",
                "software": log.text("MANUFACTURER", "SOFTWARE") or "not stated",
                **marker_facts(people, names),
            },
        )


def _markers(log: C3dFile) -> tuple[tuple[str, ...], NDArray[np.float64]]:
    """Return labels and positions (T, M, 3), without points that are no positions, such as computed angles."""
    others = {name for kind in _NO_PLACES for name in log.texts.get(("POINT", kind), [])}
    kept = [index for index, label in enumerate(log.labels) if label not in others]
    if len(kept) == len(log.labels):
        return log.labels, log.points
    return tuple(log.labels[index] for index in kept), log.points[:, kept]


def _up(log: C3dFile, names: tuple[str, ...], places_m: NDArray[np.float64], messages: list[str]) -> tuple[str, str]:
    """Return the vertical axis and the evidence; add warnings about it to `messages`."""
    screen = log.text("POINT", "Y_SCREEN").upper().replace(" ", "")
    if stated := {"+Z": "z", "Z": "z", "+Y": "y", "Y": "y"}.get(screen):
        return stated, "by POINT:Y_SCREEN"
    found = vertical_axis(names, places_m[:FRAMES_USED])
    up, how = (
        (found, "since heads are above feet")
        if found in ("y", "z")
        else ("z", "the default of most systems; not in the file")
    )
    if screen:
        messages.append(f"POINT:Y_SCREEN is {screen[:9]}, neither +Y nor +Z: {up} assumed to be up; check `up`")
    elif found == "neither":
        messages.append("heads are not above feet along y or z: z assumed to be up; check `up`")
    return up, how


def _metres(path: Path, log: C3dFile) -> tuple[float, str]:
    stated = log.text("POINT", "UNITS")
    unit = unit_of(stated)
    if unit not in METRES:
        cause = f"unknown length unit {stated[:20]!r} in POINT:UNITS" if stated else "no length unit in POINT:UNITS"
        cure = f"Known: {', '.join(METRES)}. Write the file again with one of them."
        raise DamagedLog(path, cause, nearest=nearest(unit, METRES), cure=cure)
    return METRES[unit], f"{unit}, from POINT:UNITS"


ADAPTER: Adapter = _C3d()
