"""The look of the page: template, style, script and texts; a folder of the integrator can replace each.

Files in the folder replace the page's files of the same name: `page.html.jinja`, `page.css`, `page.js`. `texts.toml`
replaces single texts (another language, or the company's own words), `extra.css` is added after the style,
`cover.html.jinja` before the first section, `logo.svg` or `logo.png` in the head. Templates run in jinja's sandbox.
"""

from __future__ import annotations

import base64
import hashlib
import re
import tomllib
from functools import cache
from importlib.resources import files
from typing import TYPE_CHECKING

import jinja2
from jinja2.sandbox import SandboxedEnvironment
from markupsafe import Markup

from cyclekit.errors import CyclekitError
from cyclekit.report import figures
from cyclekit.report.texts import load_texts
from cyclekit.storage.safe_path import name_problem, safe_path
from cyclekit.text.plain_text import visible

if TYPE_CHECKING:
    from pathlib import Path

    from cyclekit.report.play import PlayPart
    from cyclekit.report.texts import ReportTexts

PAGE, STYLE, SCRIPT = "page.html.jinja", "page.css", "page.js"
PLAY_STYLE = "play.css"
PLAY = ("tables.js", "positions.js", "lookup.js", "network.js", "grid.js", "often.js", "walk.js", "numbers.js",
        "draws.js", "agenda.js", "both.js", "joint.js", "roll.js", "chart.js", "controls.js")  # fmt: skip
"""The script of the part to play with: one function, in this order."""
LOGOS = {"logo.svg": "image/svg+xml", "logo.png": "image/png"}
KNOWN = (PAGE, STYLE, SCRIPT, "texts.toml", "extra.css", "cover.html.jinja", *LOGOS)

_WRONG = (jinja2.TemplateError, ArithmeticError, AttributeError, LookupError, RecursionError, TypeError, ValueError)
"""Errors that a running template can raise."""


_SIGNS = (
    (re.compile(r"(?<=\d) (?=(?:%|s|m|h|min)(?!\w))"), "\N{NO-BREAK SPACE}"),
    (re.compile(r"(?<=\d) (?=\d{3}(?!\w))"), "\N{NARROW NO-BREAK SPACE}"),
    (re.compile(r"(?<![^\s(])-(?=\d)"), "−"),
)
"""What a page sets better than plain text: the blank before a unit and between thousands, and the minus."""


def _shown(value: object) -> object:
    """Escape control and bidirectional characters, and set numbers; jinja itself escapes HTML."""
    if not isinstance(value, str) or isinstance(value, Markup):
        return value
    text = visible(value)
    for plain, better in _SIGNS:
        text = plain.sub(better, text)
    return text


def _own(name: str) -> str | None:
    """Return cyclekit's own file of that name; jinja calls this."""
    if name_problem(name) is not None:
        return None
    page, play = files("cyclekit.report"), files("cyclekit.report.play")
    asset = next((file for room in (page, play) if (file := room.joinpath(name)).is_file()), None)
    return asset.read_text("utf-8") if asset is not None else None


_OWN = jinja2.FunctionLoader(_own)


def _environment_of(loader: jinja2.BaseLoader) -> SandboxedEnvironment:
    return SandboxedEnvironment(
        loader=loader, autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True, finalize=_shown
    )  # fmt: skip


@cache
def _own_environment() -> SandboxedEnvironment:
    """Return the environment without a folder, which compiles each template once for all pages of a process."""
    return _environment_of(_OWN)


class Template:
    """The page's own files, and the files of a folder that replace them."""

    def __init__(self, folder: Path | None = None) -> None:
        """Check `folder`, if one is given.

        Raises:
            CyclekitError: The folder does not exist, holds none of the known files, or its texts.toml is invalid.
        """
        self.folder = folder
        if folder is not None and not any((folder / name).is_file() for name in KNOWN):
            msg = f"{folder}: {'no template file found' if folder.is_dir() else 'no such folder'}"
            raise CyclekitError(msg, cure=f"Put one or more of these files there: {', '.join(KNOWN)}.")
        self.texts = self._texts()

    def render(self, *, page: str = PAGE, play: PlayPart | None = None, **values: object) -> str:
        """Return a page; where `play` holds tables of the part to play with, also its script and style.

        Raises:
            CyclekitError: The folder's template is wrong.
        """
        script, css = self._asset(SCRIPT), self._asset(STYLE)
        data = play.data if play else None
        if data:
            parts = "".join(map(self._asset, PLAY))
            script, css = f'{script}(() => {{\n"use strict";\n{parts}}})();\n', css + self._asset(PLAY_STYLE)
        digest = base64.b64encode(hashlib.sha256(f"\n{script}\n".encode()).digest()).decode()
        try:
            return (
                self._environment()
                .get_template(page)
                .render(
                    say=self.texts,
                    language=self.texts.language,
                    css=css + self._extra("extra.css"),
                    script=script,
                    script_hash=f"sha256-{digest}",
                    logo=self._logo(),
                    play=data,
                    played=play,
                    **values,
                )
            )
        except _WRONG as error:
            msg = f"{self.folder}: the template cannot be rendered ({error})"
            raise CyclekitError(msg, cure=f"Compare it with {PAGE} of cyclekit.report.") from error

    def _environment(self) -> SandboxedEnvironment:
        if self.folder is None:
            return _own_environment()
        return _environment_of(jinja2.ChoiceLoader([jinja2.FunctionLoader(self._replaced), _OWN]))

    def _replaced(self, name: str) -> str | None:
        """Return the folder's file of that name; jinja calls this."""
        return self._extra(*name.split("/")) or None

    def _asset(self, name: str) -> str:
        return self._extra(name) or str(_own(name) or "")

    def _file(self, *names: str) -> Path | None:
        """Return a file of the folder, None where there is none.

        Raises:
            OutsideFolder: The name leads out of the folder, so the page would show a file that it should not.
        """
        file = safe_path(self.folder, *names) if self.folder else None
        return file if file is not None and file.is_file() else None

    def _extra(self, *names: str) -> str:
        file = self._file(*names)
        return file.read_text("utf-8") if file is not None else ""

    def _texts(self) -> ReportTexts:
        try:
            words = {each.name: each.words for each in figures.FIGURES if each.words}
            return load_texts().with_words(words).with_changes(tomllib.loads(self._extra("texts.toml")))
        except (tomllib.TOMLDecodeError, ValueError) as error:
            msg = f"{self.folder}: texts.toml cannot be used ({error})"
            raise CyclekitError(
                msg, cure="Keep the sections, names and {values} of cyclekit's own texts.toml."
            ) from error

    def _logo(self) -> str:
        """The logo as a data address; empty without one."""
        for name, kind in LOGOS.items():
            if (file := self._file(name)) is not None:
                return f"data:{kind};base64,{base64.b64encode(file.read_bytes()).decode()}"
        return ""
