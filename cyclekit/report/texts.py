"""Texts of the report, one file per language.

A text is looked up by its key in the file (`answer.title`) and filled with values; a missing key is a bug and raises at
once. The sections and the template choose the texts.
"""

from __future__ import annotations

import re
import tomllib
from dataclasses import dataclass, replace
from functools import cache
from importlib.resources import files
from string import Formatter
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

_TWO_ENDS = re.compile(r"(?<!\.)\.\.(?!\.)")
"""Two full stops: a sentence, such as the message of an error, at the end of another one."""


@dataclass(frozen=True)
class ReportTexts:
    """All texts of one language, by section and name."""

    sections: dict[str, dict[str, str]]
    language: str
    place: Callable[[str], str] = str

    def task(self, task: str) -> str:
        """Write a task `a->b`, or a place, for display: by the labels of the cell file."""
        return " → ".join(self.place(each) for each in task.split("->"))

    def __call__(self, key: str, **values: object) -> str:
        """Return the text at `section.name`, filled in.

        Raises:
            KeyError: The text does not exist, or a value that it needs was not given.
        """
        section, _, name = key.partition(".")
        return _TWO_ENDS.sub(".", self.sections[section][name].format(**values))

    def with_changes(self, changes: Mapping[str, Any]) -> ReportTexts:
        """Return the texts with some of them replaced; `language` may be among the changes.

        Raises:
            ValueError: A changed text does not exist, or uses a value that the original does not have.
        """
        sections = {name: dict(texts) for name, texts in self.sections.items()}
        language = str(changes.get("language", self.language))
        for section, texts in changes.items():
            if section == "language":
                continue
            for name, text in dict(texts).items():
                ours = sections.get(section, {}).get(name)
                if ours is None:
                    msg = f"there is no text {section}.{name}"
                    raise ValueError(msg)
                if strange := _values(str(text)) - _values(ours):
                    msg = f"{section}.{name} has no value {', '.join(sorted(strange))}"
                    raise ValueError(msg)
                sections[section][name] = str(text)
        return replace(self, sections=sections, language=language)

    def with_words(self, words: Mapping[str, Mapping[str, str]]) -> ReportTexts:
        """Return the texts with further sections, by name."""
        return replace(self, sections={**self.sections, **{name: dict(texts) for name, texts in words.items()}})

    def section(self, name: str) -> dict[str, str]:
        """Return all texts of one section, not filled in."""
        return self.sections[name]


def _values(text: str) -> set[str]:
    return {name for _, name, _, _ in Formatter().parse(text) if name is not None}


@cache
def load_texts() -> ReportTexts:
    """Return the English texts."""
    content = tomllib.loads(files("cyclekit.report").joinpath("texts.toml").read_text("utf-8"))
    language = str(content.pop("language"))
    return ReportTexts(content, language)
