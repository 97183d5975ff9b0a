"""Free text of logs without names and dates: only numbers, known words and words of the cell file remain.

Nobody can list all names, so what remains is listed (`known_words.txt`), and everything else is replaced: the same word
by the same code in every ingest with one key, so that two tasks or signals stay two. The key lies beside the dataset.
"""

from __future__ import annotations

import hashlib
import os
import re
import secrets
from dataclasses import astuple, dataclass, field
from functools import cache, lru_cache
from importlib.resources import files
from typing import TYPE_CHECKING

from cyclekit.errors import ConfigError
from cyclekit.storage.atomic import write_errors
from cyclekit.storage.files import resolved

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from cyclekit.config import Cell

GONE = "…"
"""Replacement for a name or a time."""
_DATE = re.compile(
    r"(?<!\d)(?<!\d\.)(?:19|20)\d\d(?:(?P<mark>[-_./ ]?)[01]\d(?P=mark)[0-3]\d)"  # 2025-10-09, 20251009
    r"(?:[T _-]{0,2}[0-2]\d[:._-]?[0-5]\d(?:[:._-]?[0-5]\d(?:[.,]\d+)?)?)?(?:Z|[+-]\d\d:?\d\d)?(?!\.?\d)"
    r"|(?<![\d.])[0-3]?\d(?P<point>[./-]) ?[0-3]?\d(?P=point) ?(?:(?:19|20)\d\d|'?\d\d)(?!\.?\d)"  # 09.10.2025, 10/9/25
    r"|(?<![\d.:])[0-2]?\d:[0-5]\d(?::[0-5]\d(?:[.,]\d+)?)?(?![\d:])"  # 14:05:12.5, 14:05
    r"|(?<!\d)(?:19|20)\d\d[-/ ]?[WQ]\d\d?(?:-?\d)?(?!\d)"  # 2026-W10
    r"|(?<![\d./-])(?:[01]?\d[/-](?:19|20)\d\d|(?:19|20)\d\d[/-][01]\d)(?![\d./-])"  # 10/2025, 2025-10
)
_MONTH = (
    r"jan(?:uary?|uar)?|jänner|feb(?:ruary?|ruar)?|mar(?:ch)?|märz?|mrz|apr(?:il)?|may|mai|june?|juni|july?|juli|"
    r"aug(?:ust)?|sept?(?:ember)?|o[ck]t(?:ober)?|nov(?:ember)?|de[cz](?:ember)?"
)
_DAY = (
    r"mon(?:day|tag)?|tue(?:s|sday)?|dienstag|wed(?:nesday)?|mittwoch|thu(?:r|rs|rsday)?|donnerstag|fri(?:day)?|freitag|"
    r"sat(?:urday)?|samstag|sonnabend|sun(?:day)?|sonntag|[kc]w|kalenderwoche|woche|week"
)
_IN_WORDS = re.compile(  # Mon Mar  2 2026, KW10 2026, 2. März
    rf"(?<![^\W_])(?:\d\d?\.?[\s_-]*)?(?:{_MONTH}|{_DAY})(?![^\W\d_])(?:[\s.,_/-]*(?:{_MONTH}|{_DAY})(?![^\W\d_]))*"
    rf"(?:[\s.,_/'-]*\d[\d:.]*(?:st|nd|rd|th|Z)?)+|(?<!\d)\d\d?\.?[\s_-]*(?:{_MONTH})(?![^\W\d_])",
    re.IGNORECASE,
)
NUMBER = re.compile(r"(?<![\w.])[+-]?\d+(?:,\d{3})*(?:\.\d+)?(?:[eE][+-]?\d+)?|\d{9,}")
_UNITS = (1.0, 1e3, 1e6, 1e9)


@cache
def known_words() -> frozenset[str]:
    """Return the words that name nobody, in lower case."""
    lines = files(__package__).joinpath("known_words.txt").read_text(encoding="utf-8").splitlines()
    return frozenset(word for line in lines if not line.startswith("#") for word in line.split())


def without_times(text: str) -> str:
    """Return a text without dates, times of day and numbers that count from 1970, 1601 or year 1."""
    text = _DATE.sub(GONE, _IN_WORDS.sub(GONE, text))
    return NUMBER.sub(lambda found: GONE if _is_time(found[0]) else found[0], text)


def _is_time(number: str) -> bool:
    """Return whether a number is a time of 1998 to 2103: s, ms, us or ns since 1970, or Windows ticks."""
    value = abs(float(number.replace(",", "")))
    since_1970 = any(9e8 <= value / unit <= 4.2e9 for unit in _UNITS)
    return since_1970 or 1.25e17 <= value <= 1.6e17 or 6.3e17 <= value <= 6.7e17


def key_file(dataset: Path) -> Path:
    """Return the file of the key: beside the dataset, never in it, so that it is not given away with it."""
    place = resolved(dataset)
    return place.with_name(f"{place.name}.key")


def kept_key(file: Path) -> bytes:
    """Return the key in a file; if there is no file, write one that only its owner can read.

    Raises:
        ConfigError: The file holds no key.
        CyclekitError: The file cannot be written or read.
    """
    with write_errors(file):
        if not file.exists():
            with os.fdopen(os.open(file, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "w", encoding="ascii") as new:
                new.write(f"{secrets.token_hex(16)}\n")
        text = file.read_text(encoding="utf-8", errors="replace")
    if re.fullmatch(r"[0-9a-f]{32}\n?", text) is None:
        cure = "Restore it, or delete it: words then get other codes than in earlier ingests."
        raise ConfigError(f"{file}: is no key of pseudonyms", cure=cure)
    return bytes.fromhex(text)


@dataclass(frozen=True)
class Words:
    """Which words of free text remain, and what stands for the others.

    Attributes:
        kept: Words that remain, in lower case, in addition to the known ones.
        key: Secret from which the replacements are made: without it no word can be tried.
    """

    kept: frozenset[str] = frozenset()
    key: bytes = field(default_factory=lambda: secrets.token_bytes(16))

    @classmethod
    def of(cls, cell: Cell) -> Words:
        """Return the rule for a cell: words of its file remain, but for those of its logs, bodies and people."""
        told = [*cell.known_words, *cell.places, *cell.human_places, *cell.furniture]
        told += [place.label or "" for place in (*cell.places.values(), *cell.human_places.values())]
        told += [text for one in cell.operator_signals for text in astuple(one) if text]
        told += [text for wait in cell.waits for text in astuple(wait) if isinstance(text, str)]
        told += [text for source in cell.sources if source.sync for text in astuple(source.sync)]
        told += cell.goal_signals
        told += [cell.executions.signal or "", cell.executions.home or ""]
        return cls(frozenset(word.lower() for text in told for word in _WORD.findall(text)))

    def hidden(self, text: str, names: Mapping[str, str] | None = None) -> str:
        """Return a text without dates, times and words that are neither known nor kept.

        Args:
            text: Free text of a log.
            names: Names of people, and what stands for them; words of them do not remain even if they are known.
        """
        names = names or {}
        people = {word.lower() for name in names if not self._known(name) for word in _WORD.findall(name)}

        def instead(found: re.Match[str]) -> str:
            kind, seen = found.lastgroup, found[0]
            if kind == "name":
                return next(names[name] for name in names if name.lower() == seen.lower())
            if kind == "word":
                return seen if self._known(seen) and seen.lower() not in people else self._code(seen)
            if kind == "dated":
                return self._code(seen)
            return GONE if kind == "date" or _is_time(seen) else seen

        return _pieces(tuple(name for name in names if len(name) > 2)).sub(instead, text)

    def _known(self, text: str) -> bool:
        """Return whether all words of a text name nobody; a single letter is none."""
        words = [word.lower() for word in _WORD.findall(text) if len(word) > 1]
        return all(word in known_words() or word in self.kept for word in words)

    def _code(self, word: str) -> str:
        """Return what stands for a word, however it is capitalised: consonants, so that it is no word or number."""
        mixed = hashlib.blake2s(word.lower().encode("utf-8", "surrogatepass"), key=self.key, digest_size=7).digest()
        return "word_" + "".join(_CONSONANTS[byte % len(_CONSONANTS)] for byte in mixed)


_CONSONANTS = "bcdfghjklmnpqrtvwxz"
_WORD = re.compile(r"[A-ZÄÖÜ]+(?![a-zäöüß])|[A-ZÄÖÜ]?[a-zäöüß]+|[^\W\d_]+")


@lru_cache(maxsize=64)
def _pieces(names: tuple[str, ...]) -> re.Pattern[str]:
    """Return the pattern of all that may have to go from a text, each kind a group of its own."""
    listed = "|".join(map(re.escape, sorted(names, key=len, reverse=True)))
    kinds = {"dated": f"(?i:{_IN_WORDS.pattern})", "date": _DATE.pattern, "number": NUMBER.pattern}
    kinds = {
        **({"name": f"(?i:(?<![^\\W\\d_])(?:{listed})(?![^\\W\\d_]))"} if listed else {}),
        **kinds,
        "word": _WORD.pattern,
    }
    return re.compile("|".join(f"(?P<{kind}>{pattern})" for kind, pattern in kinds.items()))


ODD = re.compile(r"(?<![.!?:] )(?<!^)\b[^\W\d_a-zß]\w*|\w*[_/\\@][\w/\\@.]+")
"""What stands out in a sentence of ours as a name from a log: a capital in its middle, a path, an identifier."""
