"""Rows of one robot, or of one source, in a table of several: the key `only` of a map, and the column that tells them.

`mapped_csv` reads the chosen rows, `draft` proposes the key.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from cyclekit.errors import ConfigError
from cyclekit_adapters.mapped.csv_map import WHERE

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    from cyclekit_adapters.mapped.draft_table import DraftTable
    from cyclekit_adapters.text.text_rows import TextRows

_APART = 3.0
"""Factor by which rows of two robots lie farther apart than rows of one. Half and twice of it change no draft of the
tests."""
_MOST = 8  # robots in a table
_SHOWN = 6


@dataclass
class ChosenRows:
    """Keeps the rows with given texts in some columns; the others are neither read nor lost.

    Attributes:
        only: Column -> texts.
        others: Texts of these columns that were left out.
    """

    only: Mapping[str, Sequence[str]]
    others: dict[str, None] = field(default_factory=dict)

    def rows(self, rows: TextRows) -> TextRows:
        """Return the chosen rows."""
        for column, values in self.only.items():
            mine = rows.frame[column].is_in(list(values)).fill_null(value=False)
            if not mine.all():
                self.others |= dict.fromkeys(rows.frame.filter(~mine)[column].drop_nulls().unique(maintain_order=True))
                left = rows.rows_read - int((~mine).sum())
                rows = replace(rows, frame=rows.frame.filter(mine), rows_read=left)
        return rows

    def nothing(self) -> ConfigError | None:
        """Return the error for a table without a chosen row; None if none was left out."""
        if not self.others:
            return None
        told = ", ".join(map(repr, list(self.others)[:_SHOWN]))
        return ConfigError(f"{WHERE}: only = {dict(self.only)} matches no row", cure=f"The table says {told}.")


def columns_of_several(table: DraftTable, path: NDArray[np.float64] | None) -> list[str]:
    """Return the columns of few texts by which rows side by side are of several robots.

    Rows of two texts lie far apart, rows of one near each other, though others are between them.

    Args:
        table: First rows of a table.
        path: Positions or joint angles, shape (N, D).
    """
    if path is None or len(path) < 2:
        return []
    beside = np.linalg.norm(np.diff(path, axis=0), axis=1)
    found = []
    for name, cells in table.cells.items():
        texts, which = np.unique(np.array(cells), return_inverse=True)
        if not 2 <= len(texts) <= _MOST or name in table.in_lists:
            continue
        changed = np.diff(which) != 0
        own = np.concatenate([np.linalg.norm(np.diff(path[which == k], axis=0), axis=1) for k in range(len(texts))])
        apart, own = beside[changed & np.isfinite(beside)], own[np.isfinite(own)]
        if changed.mean() > 1 / _MOST and len(apart) and len(own) and np.median(apart) > _APART * np.median(own):
            found.append(name)
    return found
