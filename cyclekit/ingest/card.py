"""Card of a dataset, made from what was read and derived."""

from __future__ import annotations

import json
from dataclasses import asdict
from typing import TYPE_CHECKING, Literal

from cyclekit import schema
from cyclekit.config import Cell
from cyclekit.dataset.cards import DatasetCard, DynamicsCard, PlaceCard, RowCounts, UnreadCard, checked
from cyclekit.extras import version

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from cyclekit.dataset.cards import RecordingCard
    from cyclekit.dataset.dataset import Place
    from cyclekit.derive.passes import Derived
    from cyclekit.ingest.read.read_logs import ReadSettings


def card_of(
    cell: Cell, derived: Derived, not_read: Sequence[tuple[str, str]], settings: ReadSettings, fingerprint: str
) -> DatasetCard:
    """Return the card, without wait conditions and file checksums."""
    return DatasetCard(
        schema_version=schema.SCHEMA_VERSION,
        cyclekit_version=version(),
        name=cell.name,
        fingerprint=fingerprint,
        pseudonymised=settings.pseudonymise,
        skeletons=settings.skeletons,
        settings=checked(json.loads(json.dumps(cell, default=vars)), Cell),
        rate_hz=cell.rate_hz,
        recordings=tuple(derived.recordings),
        not_read=tuple(UnreadCard(path=path, reason=reason) for path, reason in not_read),
        executions=tuple(derived.executions),
        places=_places(derived.places),
        human_places=_places(derived.human_places),
        positions=_placed(derived.recordings),
        levels=derived.levels,
        scaling_origin=derived.origin,
        dynamics=DynamicsCard(**asdict(derived.dynamics)),
        operator_signals=derived.operator_signals,
        rows=RowCounts(samples=derived.samples, tasks=derived.tasks.height),
        warnings=tuple(derived.warnings),
    )


def _placed(recordings: Sequence[RecordingCard]) -> tuple[Literal["robot", "people"], ...]:
    """Return whether the recordings hold positions of the robot, of people, or of both."""
    placed = {table for one in recordings if one.positions is not False for table in one.tables}
    whose: tuple[Literal["robot", "people"], ...] = ("robot", "people")
    return tuple(each for each in whose if each in placed)


def _places(places: Mapping[str, Place]) -> dict[str, PlaceCard]:
    return {
        name: PlaceCard(xyz_m=one.xyz_m, radius_m=one.radius_m, inferred=one.inferred) for name, one in places.items()
    }
