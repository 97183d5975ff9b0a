"""Which logs belong together by the words of their paths: `shift_01_anna_robot`, `shift_01_anna_take`."""

from __future__ import annotations

import re
from collections import Counter
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Sequence

_WORD = re.compile(r"[0-9]+|[^\W\d_]+")


def match_names(robots: Sequence[str], others: Sequence[str]) -> list[int] | None:
    """Return for each other log the robot log whose path has the same words, or None where names do not tell.

    Words that all robot logs or all other logs have (`robot`, `take`, `shift`) say what a log is, not to which session
    it belongs: they are left out. So are words, but not numbers, that no robot log has: the others may be of several
    kinds (`override`, `person`). Numbers are compared by value, upper and lower case are alike.

    Args:
        robots: Paths of the robot logs, without endings.
        others: Paths of the other logs, without endings.

    Returns:
        Indices into `robots`, one for each of `others`. None if two robot logs have the same words, or if one of the
        others has not the words of exactly one robot log.
    """
    of_robots, of_others = ([_words(name) for name in names] for names in (robots, others))
    common = _of_all(of_robots) | _of_all(of_others)
    known = set().union(*of_robots)
    kinds = {word for words in of_others for word in words if word not in known and not word.isdecimal()}
    keys, wanted = ([_without(words, common | kinds) for words in of] for of in (of_robots, of_others))
    places = {key: number for number, key in enumerate(keys)}
    if len(places) < len(keys) or any(not key or key not in places for key in wanted):
        return None
    return [places[key] for key in wanted]


def _words(name: str) -> Counter[str]:
    return Counter(str(int(word)) if word.isdecimal() else word.casefold() for word in _WORD.findall(name))


def _of_all(names: list[Counter[str]]) -> set[str]:
    return set.intersection(*(set(words) for words in names)) if len(names) > 1 else set()


def _without(words: Counter[str], common: set[str]) -> tuple[tuple[str, int], ...]:
    return tuple(sorted((word, count) for word, count in words.items() if word not in common))
