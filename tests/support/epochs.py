"""Epochs in which logs count their time, as the tests write them."""

from __future__ import annotations

DAY_S = 86_400.0
EPOCHS = {
    "s since 1970": (1.0, 0.0, "s"), "ms since 1970": (1e-3, 0.0, "ms"), "us since 1970": (1e-6, 0.0, "us"),
    "ns since 1970": (1e-9, 0.0, "ns"), "excel": (DAY_S, 25_569 * DAY_S, "excel"),
    "wincc": (DAY_S * 1e-6, 25_569 * DAY_S, "wincc"), "matlab": (DAY_S, 719_529 * DAY_S, "matlab"),
    "filetime": (1e-7, 11_644_473_600.0, "filetime"), "ticks": (1e-7, 62_135_596_800.0, "ticks"),
    "1904": (1.0, 2_082_844_800.0, "1904"), "gps": (1.0, -315_964_800.0 + 18.0, "gps"),
}  # fmt: skip
"""One count in s, what the count is ahead of one since 1970 in s, and the name of the unit."""
