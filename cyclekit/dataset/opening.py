"""Opening of a dataset's card: version, seal and content are checked, and the sizes of the tables against it."""

from __future__ import annotations

from typing import TYPE_CHECKING

from cyclekit import schema
from cyclekit.dataset import checksums
from cyclekit.dataset.cards import BadCard, dataset_card, parse_json, read_content
from cyclekit.dataset.row_counts import check_tables
from cyclekit.errors import DatasetError, ReplacedDataset, command_line
from cyclekit.storage.atomic import recover
from cyclekit.storage.identify import DATASET_CARD, instead_of
from cyclekit.text.plain_text import all_in_one_line, needs_escapes

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from cyclekit.dataset.cards import DatasetCard


_TRIES = 30
"""How often a dataset is opened that an ingest replaces meanwhile: each time takes milliseconds, an ingest seconds.
Half or twice as often matters only beside a writer that does nothing else."""


def opened_card(path: Path) -> tuple[DatasetCard, checksums.Stamp | None]:
    """Return the verified card of the dataset in a folder, and the stamp of its file.

    Args:
        path: The folder.

    Raises:
        DatasetError: There is no dataset, it is damaged, or it is of another schema version.
        ReplacedDataset: It is replaced again and again.
    """
    for tries_left in reversed(range(_TRIES)):
        recover(path)
        stamp = checksums.stamp_of(path / DATASET_CARD)
        try:
            card = _verified(path)
        except DatasetError:
            there = stamp is not None or not tries_left  # between two renames of a writer there is no file
            if there and checksums.stamp_of(path / DATASET_CARD) == stamp:
                raise
        else:
            if checksums.stamp_of(path / DATASET_CARD) == stamp:
                return card, stamp
    raise ReplacedDataset(path)


def _verified(path: Path) -> DatasetCard:
    try:
        content = read_content(path / DATASET_CARD)
        values = parse_json(content)
        version = _version(values)
        if version == schema.SCHEMA_VERSION:
            text = content.decode(errors="replace")
            if checksums.is_damaged(text):
                raise checksums.unreadable(path / DATASET_CARD, path, "damaged: it is not as it was written")
            card = dataset_card(all_in_one_line(values) if needs_escapes(text) else values)
            check_tables(path, card)
            return card
    except (FileNotFoundError, NotADirectoryError):
        raise _no_dataset(path) from None
    except BadCard as error:
        msg = f"{path / DATASET_CARD}: not a dataset card ({error})"
        again = command_line("ingest", "LOGS", "--out", "DATASET")
        raise DatasetError(msg, cure=f"Ingest the logs again into a new folder: {again}") from error
    except OSError as error:
        msg = f"{path / DATASET_CARD}: cannot be read ({error.strerror or error})"
        raise DatasetError(msg, cure="Check the path and its permissions.") from error
    theirs = f"dataset of schema version {version!s:.40}"
    msg = f"{path}: {theirs}, this cyclekit reads version {schema.SCHEMA_VERSION}"
    raise DatasetError(msg, cure="Ingest the logs again with this version, or use the version that made it.")


def _no_dataset(path: Path) -> DatasetError:
    """Return the error for a place without a dataset; it names what the place is."""
    ingest = command_line("ingest", path, "--out", "DATASET")
    cures = {
        "nothing": f"Check the path, or make a dataset: {command_line('ingest', 'LOGS', '--out', path)}",
        "another folder": f"If it holds logs, make a dataset of them: {ingest}",
        "else": f"Make one: {command_line('ingest', 'LOGS', '--out', 'DATASET')}",
    }
    seen, cure = instead_of(path, "dataset", DATASET_CARD, cures)
    return DatasetError(seen, cure=cure)


def _version(values: Mapping[str, object]) -> object:
    if "schema_version" not in values:
        raise BadCard("no schema_version")
    return values["schema_version"]
