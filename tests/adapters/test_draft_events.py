"""A map is drafted for exports of safety controllers: rows of time, device, event and state."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from cyclekit_adapters.mapped.draft_events import event_draft
from cyclekit_adapters.mapped.draft_table import text_draft_table

if TYPE_CHECKING:
    from pathlib import Path

PNOZ = ["Protokoll;;;;", "", "Datum;Uhrzeit;Gerät;Ereignis;Zustand"]
FIELDS, STATES = ("Warnfeld", "Schutzfeld"), ("frei", "belegt")
PNOZ += [f"25.10.2026;02:{k:02d}:07,250;S{k % 2};{FIELDS[k // 4 % 2]};{STATES[k // 2 % 2]}" for k in range(40)]
FLEXI = ["When,Severity,Tag,No,State"]
HOW = ("info,{},{},ON", "warning,{},{},OFF")
FLEXI += [f"2026-06-01T08:{k:02d}:00.120Z," + HOW[k // 2 % 2].format(f"WF{k % 2}", k) for k in range(30)]


def keys(path: Path, lines: list[str], encoding: str = "utf-8") -> dict[str, object]:
    path.write_bytes(("\n".join(lines) + "\n").encode(encoding))
    table = text_draft_table(path)
    draft = table and event_draft(table)
    return {} if draft is None else {one.key: one.value for one in (*draft.source, *draft.map) if one.sure}


def test_a_signal_named_by_device_and_event(tmp_path: Path) -> None:
    found = keys(tmp_path / "export.csv", PNOZ, "latin-1")
    assert found == {
        "role": "events",
        "encoding": "windows-1252",
        "delimiter": "semicolon",
        "skip_rows": 2,
        "time": ["Datum", "Uhrzeit"],
        "time_format": "%d.%m.%Y %H:%M:%S%.f",
        "signal": ["Gerät", "Ereignis"],
        "value": "Zustand",
    }


def test_a_severity_that_follows_the_state_is_no_part_of_the_name(tmp_path: Path) -> None:
    found = keys(tmp_path / "export.csv", FLEXI)
    assert (found["signal"], found["value"]) == ("Tag", "State")
    assert (found["time"], found["time_format"]) == ("When", "iso")


@pytest.mark.parametrize("row", ["{k},{x},0.5,0.2,{half},ok", "{k},{x},-0.5,0.2,1,run", "{k},left,table,1.5,2.5,done"])
def test_other_tables_are_no_events(tmp_path: Path, row: str) -> None:
    rows = [row.format(k=0.1 * k, x=0.01 * k, half=int(k > 20)) for k in range(60)]
    assert not keys(tmp_path / "table.csv", ["time,x,y,z,gripper,state", *rows])
