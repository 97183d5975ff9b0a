"""The words of the report, out of one file per language.

A text is asked for by its place in the file (`answer.title`) and filled with values; a missing one is a mistake of ours
and raises at once. What is said where is the business of the template.
"""

from __future__ import annotations

import re
import tomllib
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from typing import Any

_UNIT = re.compile(r"(?<=\d) (?=(?:%|s|m|h|min)(?![\w]))")
"""The space between a number and its unit, where no line may end."""


@dataclass(frozen=True)
class Texts:
    """All texts of one language, by section and name."""

    sections: dict[str, dict[str, str]]
    language: str

    def __call__(self, key: str, **values: object) -> str:
        """Return the text at `section.name`, filled in.

        Raises:
            KeyError: There is no such text, or it needs a value that was not given.
        """
        section, _, name = key.partition(".")
        return _UNIT.sub("\N{NO-BREAK SPACE}", self.sections[section][name].format(**values))

    def section(self, name: str) -> dict[str, str]:
        """Return all texts of one section, not filled in."""
        return self.sections[name]


@cache
def load_texts() -> Texts:
    """Return the English texts."""
    content: dict[str, Any] = tomllib.loads(files("cyclekit.report").joinpath("texts.toml").read_text("utf-8"))
    language = str(content.pop("language"))
    return Texts(content, language)
