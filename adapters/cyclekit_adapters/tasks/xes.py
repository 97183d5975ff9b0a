"""Event logs in XES (IEEE 1849): start and complete events of each trace, paired into tasks.

A task starts with the event whose `lifecycle:transition` is `start`, and ends with the `complete` event of the same
name, agent and, if present, `concept:instance`, within its trace. An event may instead hold its own start
(`start_timestamp`). XML is read event by event, and no reference is followed. A document type declaration, which could
define entities, is refused, and so is a tag of megabytes or excessive nesting.
"""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING
from xml.parsers import expat

from cyclekit.errors import DamagedLog, LogError
from cyclekit_adapters.tasks.lifecycle import Record, paired
from cyclekit_adapters.tasks.task_columns import columns_in
from cyclekit_adapters.text.text_blocks import characters_of

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

FIELDS = ("agent", "task", "start", "end", "execution", "planned_start", "planned_end", "outcome")
_LONGEST_TAG = 1 << 20
_DEEPEST = 64
_MAX_HELD = 1 << 27
"""Maximum size of the events of one trace, bytes of text and _EACH for each value: a trace is held in memory as a
whole. A size; it is 300 bytes for a usual event, so 400,000 events."""
_EACH = 60
_PIECE = 1 << 16
_VALUES = {"string", "date", "int", "float", "boolean", "id"}


def is_xes(head: str) -> bool:
    """Return whether these are the first characters of an event log in XES."""
    text = head.lstrip("\ufeff \t\r\n")
    return text.startswith("<") and "<log" in text and ("xes" in text or "concept:name" in text)


class XesRecords:
    """Tasks of a file, one at a time; after iteration, the attributes describe what was skipped.

    Attributes:
        broken: Reason why the file ends early; None if it does not.
        events: Number of events read.
        passed_over: Transition -> number of events that neither start nor end a task.
    """

    def __init__(self, path: Path) -> None:
        """Store the path; the file is read on iteration."""
        self._path = path
        self.broken: str | None = None
        self.events = 0
        self.passed_over: Counter[str] = Counter()

    def __iter__(self) -> Iterator[Record]:
        """Yield each task as field -> text (`FIELDS`), or a record with key `NO_START`.

        Raises:
            DamagedLog: The content is not that of an event log.
            LogError: The file cannot be read.
        """
        document = _Document(self._path)
        try:
            for piece in characters_of(self._path):
                for first in range(0, len(piece), _PIECE):
                    document.feed(piece[first : first + _PIECE])
                    yield from self._taken(document)
            document.feed("", final=True)
        except expat.ExpatError as error:
            self.broken = f"the document is cut or garbled at line {error.lineno}"
        except OSError as error:
            raise LogError(self._path, f"cannot be read: {error.strerror}", cure="Check the path.") from error
        yield from self._taken(document, last=True)

    def _taken(self, document: _Document, *, last: bool = False) -> Iterator[Record]:
        for execution, events in document.taken(last=last):
            self.events += len(events)
            yield from paired((_record(event, execution) for event in events), self.passed_over)


def _record(event: Record, execution: str | None) -> Record:
    """Return the fields of an event; its time is stored as `end` until the event proves to be a start."""
    found = columns_in([key for key in event if key not in ("concept:name", "time:timestamp", "org:resource")])
    record = {key: event[name] for key, name in found.items() if key in FIELDS}
    usual = {
        "task": "concept:name",
        "end": "time:timestamp",
        "agent": "org:resource",
        "instance": "concept:instance",
        "transition": "lifecycle:transition",
    }
    record |= {key: event[name] for key, name in usual.items() if name in event}
    return record | ({} if execution is None else {"execution": execution})


class _Document:
    """Parser of the XML: collects traces and their events, skips everything else."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._parser = expat.ParserCreate("utf-8")  # whatever it declares: `characters_of` has decoded it
        self._parser.buffer_text = False
        self._parser.StartElementHandler = self._start
        self._parser.EndElementHandler = self._end
        self._parser.StartDoctypeDeclHandler = self._refuse
        self._parser.EntityDeclHandler = self._refuse
        self._open: list[str] = []
        self._fed = self._held = 0
        self._trace: Record = {}
        self._event: Record | None = None
        self._events: list[Record] = []
        self._done: list[tuple[str | None, list[Record]]] = []

    def feed(self, text: str, *, final: bool = False) -> None:
        raw = text.encode("utf-8", "replace")
        self._fed += len(raw)
        self._parser.Parse(raw if not final else b"", final)
        if self._fed - max(self._parser.CurrentByteIndex, 0) > _LONGEST_TAG:
            raise DamagedLog(self._path, "a tag of more than 1 MiB: not an event log", cure="Check what the file is.")

    def taken(self, *, last: bool) -> list[tuple[str | None, list[Record]]]:
        """Return the complete traces, and with `last` also the unfinished one."""
        if last and self._events:
            self._close_trace()
        done, self._done = self._done, []
        return done

    def _start(self, tag: str, about: dict[str, str]) -> None:
        name = tag.rpartition(":")[2]
        if len(self._open) >= _DEEPEST:
            raise DamagedLog(
                self._path, f"tags nested {_DEEPEST} deep: not an event log", cure="Check what the file is."
            )
        around = self._open[-1] if self._open else ""
        self._open.append(name)
        if name == "event":
            self._event = {}
        elif name in _VALUES and around in ("event", "trace") and "key" in about:
            into = self._event if around == "event" and self._event is not None else self._trace
            into[about["key"]] = about.get("value", "")
            self._held += _EACH + len(about["key"]) + len(about.get("value", ""))
            if self._held > _MAX_HELD:
                raise DamagedLog(self._path, f"a trace of more than {_MAX_HELD >> 20} MiB of events", cure="Split it.")

    def _end(self, tag: str) -> None:
        name = self._open.pop()
        if name == "event" and self._event is not None:
            self._events.append(self._event)
            self._event = None
        elif name == "trace":
            self._close_trace()

    def _close_trace(self) -> None:
        self._done.append((self._trace.get("concept:name"), self._events))
        self._trace, self._events, self._held = {}, [], 0

    def _refuse(self, *about: object) -> None:
        cause = "it holds a document type declaration, which may define entities: not read"
        raise DamagedLog(self._path, cause, cure="Remove the <!DOCTYPE ...> at its beginning.")
