"""What is said of many files: once, with how many they are, where it is the same of all."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterable

ALONE = 3
"""Of so many files the same thing is said of each."""
SHOWN = 20
"""More lines than these nobody reads; `--json` has all."""


def grouped(said: Iterable[tuple[str, str]], *, things: str = "files") -> list[str]:
    """Return `name: text` lines of names and texts, those of the same text put together, in the order they came.

    Args:
        said: Name of a file, and what is said of it; without a name the text stands alone.
        things: What the names are names of.
    """
    names: dict[str, dict[str, None]] = {}
    for name, text in said:
        names.setdefault(text, {})[name] = None
    lines: list[str] = []
    for text, those in names.items():
        if len(those) <= ALONE:
            lines += [f"{name}: {text}" if name else text for name in those]
        else:
            lines.append(f"{len(those)} {things} ({', '.join(list(those)[:ALONE])}, …): {text}")
    left = len(lines) - SHOWN
    return lines if left <= 0 else [*lines[:SHOWN], f"and {left} more lines of this kind; --json has all"]
