"""`dataset.json`: what a dataset says of itself, beside its tables."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Literal

import msgspec

from cyclekit.config.cells import Cell
from cyclekit.dataset.cards.coupling import CouplingCard
from cyclekit.dataset.cards.notes import Note, from_sentences
from cyclekit.dataset.cards.quantities import (
    Card,
    Count,
    Digest,
    Duration,
    Fraction,
    Hertz,
    Length,
    Name,
    Point,
    Scaling,
    Seconds,
    ascending,
)
from cyclekit.dataset.cards.read import checked
from cyclekit.dataset.cards.recording import RecordingCard


class ExecutionCard(Card, frozen=True, kw_only=True):
    """One execution of the process.

    Attributes:
        execution: Its name.
        session: The session it is part of.
        part: The file of its samples, without the ending; None = it has the name of the session.
        start_s, end_s: Session time.
        complete: The log shows all of it.
        reference: Recorded without an operator, as the cell file says.
        places: Where the robot stopped, in order.
        logged_as: Its name in a task list; None where there is none.
    """

    execution: Name
    session: Name
    part: Name | None = None
    start_s: Seconds
    end_s: Seconds
    complete: bool
    reference: bool = False
    places: tuple[str, ...] = ()
    logged_as: str | None = None

    def __post_init__(self) -> None:
        """Refuse an execution that ends before it begins.

        Raises:
            ValueError: It does.
        """
        if self.end_s < self.start_s:
            msg = "end_s must not be before start_s"
            raise ValueError(msg)


class PlaceCard(Card, frozen=True, kw_only=True):
    """A place of the robot or the operator.

    Attributes:
        xyz_m: Its centre, robot base frame.
        radius_m: Positions within it count as being there.
        inferred: Found in the logs; False where the cell file names it.
    """

    xyz_m: Point
    radius_m: Length
    inferred: bool


class UnreadCard(Card, frozen=True, kw_only=True):
    """A file that was found and not used."""

    path: str
    reason: str


class DynamicsCard(Card, frozen=True, kw_only=True):
    """The safety function in time, as far as the logs show it; None = not visible.

    Attributes:
        latency_s: From crossing a threshold to the beginning of the change of speed.
        ramp_down_per_s, ramp_up_per_s: Change of the scaling per second; None also where it jumps.
        hysteresis_m: How much farther away than where it slowed the robot speeds up again.
        changes: Changes of level that were seen.
        spread_m: Median deviation of the places at which levels change, at that latency.
        hold_s: How much later than it slows down the robot speeds up again; None: not later.
        ramp_down_se_per_s, ramp_up_se_per_s: Standard errors of the rates.
    """

    latency_s: Seconds | None = None
    ramp_down_per_s: float | None = None
    ramp_up_per_s: float | None = None
    hysteresis_m: Length | None = None
    changes: Count = 0
    spread_m: Length | None = None
    hold_s: Seconds | None = None
    ramp_down_se_per_s: float | None = None
    ramp_up_se_per_s: float | None = None


class OperatorSignalCard(Card, frozen=True, kw_only=True):
    """A signal that tells of people: the field of a scanner, a light curtain, a door.

    Attributes:
        name: What it is called; bit k of column `human_signals` is that of entry k.
        signal: The signal in the logs: `digital-input 3`, or the name of an event.
        recording: Id of the recording that holds it; None: in several sessions each has a recording of its own.
        occupied: Its value, as text, while somebody is there.
        delay_s: From its change to the beginning of the change of speed.
        explained: Share of the time lost to speed scaling that it explains together with those before it.
        told: The cell file names it; False where it was found in the logs.
    """

    name: Name
    signal: Name
    recording: str | None = None
    occupied: str
    delay_s: Duration = 0.0
    explained: Fraction = 0.0
    told: bool = False


class RowCounts(Card, frozen=True, kw_only=True):
    """Rows of the tables that all recordings share."""

    samples: Count
    tasks: Count


class FileCard(Card, frozen=True, kw_only=True):
    """A file of the dataset as it was written: its size in bytes, and the BLAKE3 of each piece (`checksums`).

    `piece_bytes`: of how many bytes each is, if there are several; None in those of an earlier version.
    """

    size: Count
    blake3: tuple[Digest, ...]
    piece_bytes: Annotated[int, msgspec.Meta(ge=1)] | None = None


class DatasetCard(Card, frozen=True, kw_only=True):
    """A dataset.

    Attributes:
        schema_version: Of its tables and of this card.
        cyclekit_version: Which made it.
        name: Of the cell.
        fingerprint: Changes when the logs, the cell file, the options or cyclekit do.
        pseudonymised: Neither the names that trackers give nor the time of day were kept.
        skeletons: Every joint of every person was kept.
        settings: The cell file.
        rate_hz: Of the samples.
        recordings: The logs.
        not_read: Files that were found and not used.
        executions: In the order of sessions and time.
        places, human_places: Of the robot and the operator, by name.
        positions: Of whom places are known: robot, people; None = an earlier version did not say.
        levels: Of the speed scaling, ascending; empty where none were found.
        scaling_origin: `logged`, `inferred`, both joined by "and"; None without a scaling.
        dynamics: The safety function in time.
        operator_signals: Signals that tell of people, in the order of the bits of `human_signals`.
        rows: Of the shared tables.
        coupling: Who waits for whom; None where too few executions show both agents, or an earlier version made it.
        warnings: What a person must know before trusting it.
        files: Every other file of the dataset, by its path in there; None in those of an earlier version.
        card_blake3: Seals this card; None likewise.
    """

    schema_version: int
    cyclekit_version: str = "unknown"
    name: str
    fingerprint: str = ""
    pseudonymised: bool = False
    skeletons: bool = False
    settings: Cell = Cell()
    rate_hz: Hertz = 10.0
    recordings: tuple[RecordingCard, ...]
    not_read: tuple[UnreadCard, ...] = ()
    executions: tuple[ExecutionCard, ...]
    places: dict[str, PlaceCard]
    human_places: dict[str, PlaceCard]
    positions: tuple[Literal["robot", "people"], ...] | None = None
    levels: tuple[Scaling, ...]
    scaling_origin: str | None = None
    dynamics: DynamicsCard = DynamicsCard()
    operator_signals: Annotated[tuple[OperatorSignalCard, ...], msgspec.Meta(max_length=32)] = ()
    rows: RowCounts
    coupling: CouplingCard | None = None
    warnings: tuple[Note, ...] = ()
    files: dict[str, FileCard] | None = None
    card_blake3: Digest | None = None

    def __post_init__(self) -> None:
        """Refuse levels that are not ascending, and names that stand for two things.

        Raises:
            ValueError: There are some.
        """
        ascending(self.levels)
        for what, names in (
            ("execution", [one.execution for one in self.executions]),
            ("recording", [one.id for one in self.recordings]),
        ):
            if len(set(names)) < len(names):
                msg = f"two {what}s have the same name"
                raise ValueError(msg)


def dataset_card(values: Mapping[str, object]) -> DatasetCard:
    """Return the JSON values of a dataset's card as that card; warnings may be sentences, as in an earlier version.

    Raises:
        BadCard: A value is missing or not of its kind.
    """
    values = {**values, "warnings": from_sentences(values.get("warnings", []))}
    if isinstance(recordings := values.get("recordings"), list):
        values["recordings"] = [_with_notes(one) for one in recordings]
    return checked(values, DatasetCard)


def _with_notes(recording: object) -> object:
    if not isinstance(recording, dict) or "warnings" not in recording:
        return recording
    return {**recording, "warnings": from_sentences(recording["warnings"])}
