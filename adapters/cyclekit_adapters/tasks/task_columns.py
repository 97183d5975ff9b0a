"""Columns of a task list: agent, task, start, end or duration, and optional fields.

Task planners, MES exports and loggers use different names. The usual ones are listed in NAMES, and `[sources.map]`
gives any other. `task_cells` interprets the cells.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from cyclekit.errors import ConfigError, LogError, UnknownName, nearest
from cyclekit_adapters.tasks.event_table import stem_of
from cyclekit_adapters.times.units import checked_unit
from cyclekit_adapters.times.written_time import checked_zone

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence
    from pathlib import Path

    from cyclekit.adapter import ReadOptions
    from cyclekit_adapters.times.units import Unit

WHERE = "[sources.map] of a task list"
NAMES: Mapping[str, tuple[str, ...]] = {
    "agent": ("agent", "agentname", "agentid", "resource", "resourcename", "orgresource", "performer", "performedby",
              "executor", "executedby", "actor", "assignee", "assignedto", "who", "resourceid", "ressource",
              "bearbeiter", "employee"),
    "task": ("task", "taskname", "activity", "activityname", "conceptname", "action", "actionname", "skill",
             "skillname", "operation", "operationname", "name", "taskid", "activityid", "aktivität", "tätigkeit",
             "aufgabe", "arbeitsschritt", "arbeitsgang", "vorgang", "schritt", "step"),
    "start": ("start", "tstart", "starttime", "starttimestamp", "startdate", "startdatetime", "startedat", "started",
              "timestart", "realstart", "startreal", "tstartreal", "actualstart", "startactual", "begin", "tbegin",
              "begintime", "from", "begintimestamp", "beginn", "anfang", "startzeit", "startzeitpunkt", "beginnzeit",
              "startuhrzeit", "startdatum", "iststart", "istbeginn", "gestartet", "von"),
    "end": ("end", "tend", "endtime", "endtimestamp", "enddate", "enddatetime", "endedat", "ended", "timeend",
            "realend", "endreal", "tendreal", "actualend", "endactual", "finish", "tfinish", "finishtime", "finished",
            "finishedat", "completiontime", "completedat", "stop", "stoptime", "to", "until", "completetimestamp",
            "timetimestamp", "complete", "completed", "completetime", "completiontimestamp", "finishtimestamp", "ende",
            "endzeit", "endzeitpunkt", "endezeit", "enduhrzeit", "enddatum", "istende", "beendet", "fertig", "bis",
            "timestamp"),
    "duration": ("duration", "tduration", "taskduration", "actualduration", "durationactual", "realduration",
                 "durationreal", "elapsed", "elapsedtime", "timetaken", "dauer", "istdauer"),
    "execution": ("execution", "executionid", "executionname", "run", "runid", "recipe", "recipeid", "recipename",
                  "cycle", "cycleid", "case", "caseid", "caseconceptname", "trial", "trialid", "episode", "zyklus",
                  "durchlauf", "fall"),
    "planned_start": ("plannedstart", "startplanned", "tstartplanned", "plannedtstart", "plannedstarttime",
                      "starttimeplanned", "scheduledstart", "startscheduled", "tstartscheduled", "planstart",
                      "planstarttime", "notbefore", "sollstart", "sollbeginn", "planbeginn"),
    "planned_end": ("plannedend", "endplanned", "tendplanned", "plannedtend", "plannedendtime", "endtimeplanned",
                    "scheduledend", "endscheduled", "tendscheduled", "planend", "planendtime", "plannedfinish",
                    "sollende", "planende"),
    "outcome": ("outcome", "result", "success", "succeeded", "status", "taskstatus", "state", "taskstate"),
    "transition": ("lifecycletransition", "lifecycleid", "lifecycle", "lifecyclestate", "registrationtype",
                   "eventtype"),
    "instance": ("conceptinstance", "activityinstanceid", "activityinstance", "taskinstance", "taskinstanceid"),
}  # fmt: skip
"""Field -> usual column names, in lower case with letters and digits only, the most likely first."""
FLOW = "part"
"""The agent of a list that names none, but orders and what is done to each: the part goes from task to task."""
_OF_FLOW: Mapping[str, tuple[str, ...]] = {
    "task": ("station", "stationname", "stationid", "workstation", "workcenter", "workcentre", "machine", "machinename",
             "machineid", "maschine", "arbeitsplatz", "platz", "anlage", "resourcegroup"),
    "execution": ("order", "orderno", "ordernr", "ordernumber", "orderid", "workorder", "workorderid",
                  "productionorder", "auftrag", "auftragsnr", "auftragsnummer", "fertigungsauftrag", "serial",
                  "serialno", "serialnumber", "seriennummer", "sn", "lot", "lotid", "batch", "batchid", "charge",
                  "partid", "unitid", "job", "jobid"),
}  # fmt: skip
"""The same for a list without agents, as an MES writes it."""
_OF_EVENTS = ("time", "datetime", "date", "zeit", "zeitstempel", "zeitpunkt")
"""Names of the time of a row that is the start or the end of a task, which its transition tells."""
NEEDED = ("agent", "task", "start", "end")
"""Fields of every task list; a `duration` may stand for the `end`, and a `transition` for the `start`."""
TIMES = ("start", "end", "planned_start", "planned_end")
_TIME_NAMES = frozenset(name for field in (*TIMES, "duration") for name in NAMES[field])


@dataclass(frozen=True)
class Settings:
    """Settings of the cell file for a task list.

    Attributes:
        columns: Field -> column, for the fields given.
        robot: Agents that are robots, whatever their names.
        operator: Agents that are people.
        unit: Unit of times that are numbers.
        zone: Time zone of times that name none.
    """

    columns: Mapping[str, str] = field(default_factory=dict)
    robot: tuple[str, ...] = ()
    operator: tuple[str, ...] = ()
    unit: Unit | None = None
    zone: str | None = None


def settings_of(options: ReadOptions) -> Settings:
    """Return the settings of the cell file.

    Raises:
        ConfigError: A setting is invalid.
    """
    if options.role not in (None, "tasks"):
        cure = 'Leave role out, or give role = "tasks".'
        raise ConfigError(f"a task list cannot be read as {options.role}", cure=cure)
    known = [*NAMES, "robot", "operator", "time_unit", "time_zone"]
    for key in options.map:
        if key not in known:
            raise UnknownName(WHERE, "key", key, known)
    lists = {key: _names(key, options.map.get(key, [])) for key in ("robot", "operator")}
    if both := sorted({*lists["robot"]} & {*lists["operator"]}):
        raise ConfigError(f"{WHERE}: {both[0]!r} is in robot and in operator", cure="Keep it in one of them.")
    texts = {key: _text(key, options.map[key]) for key in (*NAMES, "time_unit", "time_zone") if key in options.map}
    unit, zone = texts.pop("time_unit", None), texts.pop("time_zone", None)
    stated = None if unit is None else checked_unit(unit, WHERE)
    return Settings(texts, lists["robot"], lists["operator"], stated, checked_zone(zone, WHERE))


def _names(key: str, value: object) -> tuple[str, ...]:
    if not isinstance(value, list | tuple) or not all(isinstance(name, str) for name in value):
        raise ConfigError(f"{WHERE}: {key} = {value!r} is not a list of names", cure=f'{key} = ["NAME"]')
    return tuple(map(str, value))


def _text(key: str, value: object) -> str:
    if not isinstance(value, str):
        raise ConfigError(f"{WHERE}: {key} = {value!r} is not a text", cure=f'{key} = "NAME"')
    return value


def columns_in(names: Iterable[str], given: Mapping[str, str] | None = None) -> dict[str, str]:
    """Return field -> column, for the fields that the names identify.

    Args:
        names: Column names.
        given: Field -> column, as given in the cell file.
    """
    found = dict(given or {})
    stems: dict[str, str] = {}
    for name in names:
        stems.setdefault(stem_of(name, _TIME_NAMES), name)
    taken = set(found.values())
    for key, usual in NAMES.items():
        column = next((stems[word] for word in usual if word in stems and stems[word] not in taken), None)
        if key not in found and column is not None:
            found[key] = column
            taken.add(column)
    for key, usual in {} if "agent" in found else _OF_FLOW.items():
        free = [stems[word] for word in usual if word in stems and stems[word] not in found.values()]
        found |= {key: free[0]} if key not in found and free else {}
    if "transition" in found and not {"start", "end"} & set(found):
        found |= dict([("end", stems[word]) for word in _OF_EVENTS if word in stems][:1])
    if "end" in found and "duration" not in (given or {}):
        found.pop("duration", None)
    return found


def missing_in(found: Mapping[str, str]) -> list[str]:
    """Return the fields of NEEDED that have no column; orders need no agent, as each is a flow of its own."""
    instead = {"end": "duration", "start": "transition"} | ({"agent": "execution"} if "start" in found else {})
    return [key for key in NEEDED if key not in found and instead.get(key) not in found]


def is_task_list(names: Sequence[str]) -> bool:
    """Return whether columns with these names are a task list."""
    return not missing_in(columns_in(names))


def require(path: Path, names: Sequence[str], given: Mapping[str, str]) -> dict[str, str]:
    """Return field -> column of a log.

    Raises:
        LogError: A column given in the cell file is missing, or there is no column for a field of `NEEDED`.
    """
    for key, name in given.items():
        if name not in names:
            cause = f"no column {name!r}, which [sources.map] names for {key}"
            raise LogError(path, cause, nearest=nearest(name, names), cure=f"It has: {', '.join(names[:40])}.")
    found = columns_in(names, given)
    if missing := missing_in(found):
        cause = f"no column is known for {', '.join(missing)} (it has {', '.join(names[:40])})"
        raise LogError(path, cause, cure=f'Name it in [sources.map] of the cell file: {missing[0]} = "COLUMN"')
    return found
