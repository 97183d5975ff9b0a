"""`dataset.json`: the card of a dataset, stored with its tables."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Annotated, Literal

import msgspec

from cyclekit.config.cells import Cell
from cyclekit.dataset.cards.coupling import CouplingCard
from cyclekit.dataset.cards.notes import Note, from_sentences
from cyclekit.dataset.cards.quantities import (
    Card,
    Count,
    Digest,
    Fraction,
    Hertz,
    Lag,
    Length,
    Measure,
    Name,
    Point,
    Ramp,
    Scaling,
    Seconds,
    SignedDelay,
    Work,
    ascending,
)
from cyclekit.dataset.cards.read import checked
from cyclekit.dataset.cards.recording import RecordingCard


class ExecutionCard(Card, frozen=True, kw_only=True):
    """One execution of the process.

    Attributes:
        execution: Its name.
        session: Name of its session.
        part: Name of its sample file, without the suffix; None = the name of the session.
        start_s, end_s: Session time.
        complete: Whether the log shows all of it.
        interrupted_s: Time for which it was interrupted by what is no part of a cycle; estimates leave it out then.
        reference: Whether it was recorded without an operator, according to the cell file.
        places: Places where the robot stopped, in order.
        logged_as: Its name in a task list; None without one.
    """

    execution: Name
    session: Name
    part: Name | None = None
    start_s: Seconds
    end_s: Seconds
    complete: bool
    interrupted_s: Seconds = 0.0
    reference: bool = False
    places: tuple[str, ...] = ()
    logged_as: str | None = None

    def __post_init__(self) -> None:
        """Refuse an execution that ends before it begins.

        Raises:
            ValueError: It ends before it begins.
        """
        if self.end_s < self.start_s:
            msg = "end_s must not be before start_s"
            raise ValueError(msg)

    @property
    def whole(self) -> bool:
        """Whether it shows a whole cycle: complete and not interrupted."""
        return self.complete and not self.interrupted_s


def begun(executions: Sequence[ExecutionCard]) -> list[ExecutionCard]:
    """Return the whole executions, and those that the end of a log cuts and that begin where whole ones do."""
    firsts = {one.places[:1] for one in executions if one.whole}
    return [one for one in executions if one.whole or (not one.interrupted_s and one.places[:1] in firsts)]


class PlaceCard(Card, frozen=True, kw_only=True):
    """A place of the robot or the operator.

    Attributes:
        xyz_m: Its centre, robot base frame.
        radius_m: Radius within which a position counts as at the place.
        inferred: Whether it was found in the logs; False if the cell file names it.
    """

    xyz_m: Point
    radius_m: Length
    inferred: bool


class UnreadCard(Card, frozen=True, kw_only=True):
    """A file that was found but not used."""

    path: str
    reason: str


class DynamicsCard(Card, frozen=True, kw_only=True):
    """Response of the safety function over time, as seen in the logs; None = not visible.

    Attributes:
        latency_s: Time from crossing a threshold to the start of the speed change.
        ramp_down_per_s, ramp_up_per_s: Rate of change of the scaling, 1/s; None also if it jumps.
        hysteresis_m: Difference between the distances at which the robot speeds up and slows down.
        changes: Number of level changes seen.
        spread_m: Median deviation of the distances at which levels change, at that latency.
        hold_s: Delay of speeding up relative to slowing down; None: no difference.
        ramp_down_se_per_s, ramp_up_se_per_s: Standard errors of the rates.
    """

    latency_s: SignedDelay | None = None
    ramp_down_per_s: Ramp | None = None
    ramp_up_per_s: Ramp | None = None
    hysteresis_m: Length | None = None
    changes: Count = 0
    spread_m: Length | None = None
    hold_s: Lag | None = None
    ramp_down_se_per_s: Measure | None = None
    ramp_up_se_per_s: Measure | None = None


class OperatorSignalCard(Card, frozen=True, kw_only=True):
    """A signal of people: the field of a scanner, a light curtain, a door.

    Attributes:
        name: Display name; bit k of column `human_signals` belongs to entry k.
        signal: The signal in the logs: `digital-input 3`, or the name of an event.
        recording: Id of its recording; None: each session has its own recording of it.
        occupied: Value, as text, while a person is present.
        reset: Signal of the reset button, if the stop lasts until it is pressed after the signal is free again.
        reset_at: Value, as text, to which it changes at the reset; empty without a reset.
        delay_s: Time from its change to the start of the speed change.
        hold_s: Additional delay of speeding up after it is free (a restart delay); None: not seen.
        explained: Share of the time lost to speed scaling that is explained by it and the signals before it.
        told: Whether the cell file names it; False if it was found in the logs.
    """

    name: Name
    signal: Name
    recording: str | None = None
    occupied: str
    reset: Name | None = None
    reset_at: str = ""
    delay_s: Work = 0.0
    hold_s: Work | None = None
    explained: Fraction = 0.0
    told: bool = False


class RowCounts(Card, frozen=True, kw_only=True):
    """Row counts of the tables shared by all recordings."""

    samples: Count
    tasks: Count


class FileCard(Card, frozen=True, kw_only=True):
    """A file of the dataset when it was written: its size in bytes, and the BLAKE3 of each piece (`checksums`).

    `piece_bytes`: bytes per piece if there are several pieces; None in cards of earlier versions.
    """

    size: Count
    blake3: tuple[Digest, ...]
    piece_bytes: Annotated[int, msgspec.Meta(ge=1, le=2**40)] | None = None


class DatasetCard(Card, frozen=True, kw_only=True):
    """The card of a dataset.

    Attributes:
        schema_version: Version of its tables and of this card.
        cyclekit_version: Version that made it.
        name: Name of the cell.
        fingerprint: Changes with the logs, the cell file, the options or cyclekit.
        pseudonymised: Whether names from trackers and the time of day were left out.
        skeletons: Whether every joint of every person was kept.
        settings: Content of the cell file.
        rate_hz: Rate of the samples.
        recordings: The logs.
        not_read: Files that were found but not used.
        executions: The executions, ordered by session and time.
        places, human_places: Places of the robot and of the operator, by name.
        positions: Agents with known positions: robot, people; None = an earlier version did not store it.
        levels: Levels of the speed scaling, ascending; empty if none were found.
        scaling_origin: `logged`, `inferred`, or both joined by "and"; None without a scaling.
        dynamics: Response of the safety function over time.
        operator_signals: Signals of people, in the order of the bits of `human_signals`.
        rows: Row counts of the shared tables.
        coupling: Wait conditions of robot and operator; None if too few executions show both agents, or an earlier
            version made the dataset.
        warnings: Limits of the dataset that a user must know.
        files: Every other file of the dataset, by its path in it; None in cards of earlier versions.
        card_blake3: Checksum of this card; None in cards of earlier versions.
    """

    schema_version: Count
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
        """Refuse levels that are not ascending, and repeated names.

        Raises:
            ValueError: Levels are not ascending, or a name is repeated.
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
    """Return JSON values as the card of a dataset; warnings may be sentences, as in earlier versions.

    Raises:
        BadCard: A value is missing or invalid.
    """
    values = {**values, "warnings": from_sentences(values.get("warnings", []))}
    if isinstance(recordings := values.get("recordings"), list):
        values["recordings"] = [_with_notes(one) for one in recordings]
    return checked(values, DatasetCard)


def _with_notes(recording: object) -> object:
    if not isinstance(recording, dict) or "warnings" not in recording:
        return recording
    return {**recording, "warnings": from_sentences(recording["warnings"])}
