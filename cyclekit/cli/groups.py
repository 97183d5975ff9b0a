"""Groups identical messages about many files into one line with the number of files."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterable

ALONE = 3
"""Maximum number of files whose identical messages are listed separately."""
SHOWN = 20
"""Maximum number of lines; `--json` has all."""


def grouped(said: Iterable[tuple[str, str]], *, things: str = "files") -> list[str]:
    """Return `name: text` lines in the order of their first text; many equal texts share one line.

    Args:
        said: Pairs of a file's name and a message; an empty name is left out.
        things: Plural noun for the named things.
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


def regrouped(texts: Iterable[str]) -> list[str]:
    """Return sentences with those of many files on one line, as `grouped`; `file: text` begins with a file's name."""
    parts = [text.partition(": ") for text in texts]
    return grouped(
        (name, rest) if rest and " " not in name else ("", name + colon + rest) for name, colon, rest in parts
    )
