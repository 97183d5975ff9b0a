"""The page as PDF, printed by an installed browser.

A browser prints the page as the reader sees it, with vector pictures, and needs no further dependency: Windows comes
with Edge, and most other machines have Chromium or Chrome. The page's content policy blocks loading anything else.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from cyclekit.errors import CyclekitError
from cyclekit.storage.atomic import replaced
from cyclekit.storage.scratch import Scratch

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome", "msedge", "microsoft-edge")
_PLACES = (
    ("PROGRAMFILES(X86)", "Microsoft/Edge/Application/msedge.exe"),
    ("PROGRAMFILES", "Microsoft/Edge/Application/msedge.exe"),
    ("PROGRAMFILES", "Google/Chrome/Application/chrome.exe"),
)
_MAC = ("Google Chrome.app/Contents/MacOS/Google Chrome", "Microsoft Edge.app/Contents/MacOS/Microsoft Edge")
PATIENCE_S = 120.0
_OBJECT = re.compile(rb"(\d+) 0 obj\n(.*?)endobj", re.DOTALL)
_PAGE_OF = re.compile(r'<span data-page-of="([\w-]+)">')


def find_browser() -> Path | None:
    """Return an installed browser of the Chromium family, None if there is none."""
    for name in NAMES:
        if found := shutil.which(name):
            return Path(found)
    places = [Path(os.environ[variable]) / rest for variable, rest in _PLACES if variable in os.environ]
    places += [Path("/Applications") / rest for rest in _MAC]
    return next((place for place in places if place.is_file()), None)


def need_browser() -> Path:
    """Return a browser that can print; called before the page is made, so that the error comes early.

    Raises:
        CyclekitError: None is installed.
    """
    browser = find_browser()
    if browser is None:
        cure = "Install Chromium, Chrome or Edge; or open the page in any browser and print it to PDF (A4)."
        raise CyclekitError("no browser is installed that can print the page", cure=cure)
    return browser


def browser_options(profile: Path) -> list[str]:
    """Return the options for a headless browser with its own profile and without network calls of its own."""
    options = ["--headless", "--disable-gpu", "--no-first-run", "--disable-background-networking", "--disable-sync"]
    if sys.platform.startswith("linux") and os.geteuid() == 0:
        options.append("--no-sandbox")  # Chromium has no sandbox for root
    return [*options, f"--user-data-dir={profile}"]


def write_pdf(page: Path, out: Path) -> int:
    """Print `page` (HTML) to `out` (PDF); an existing file is replaced when the new one is complete.

    A browser does not know the page numbers of a table of contents while it prints. So the page is printed twice, the
    second time with the numbers that the first PDF shows.

    Returns:
        Size of the PDF in bytes.

    Raises:
        CyclekitError: No browser is installed, or it fails, or the file cannot be written.
    """
    browser = need_browser()
    with Scratch() as scratch, replaced(out) as temporary:
        printed = _print(browser, page, scratch.path)
        text = page.read_text("utf-8")
        numbered = with_page_numbers(text, pages_of_sections(printed))
        if numbered != text:
            copy = scratch.path / "page.html"
            copy.write_text(numbered, "utf-8")
            printed = _print(browser, copy, scratch.path)
        temporary.write_bytes(printed + b"\n% written by cyclekit\n")  # a PDF comment: viewers ignore it
    return out.stat().st_size


def _print(browser: Path, page: Path, folder: Path) -> bytes:
    printed = folder / "page.pdf"
    printed.unlink(missing_ok=True)
    options = [*browser_options(folder / "profile"), "--no-pdf-header-footer", "--generate-pdf-document-outline"]
    command = [str(browser), *options, f"--print-to-pdf={printed}", page.resolve().as_uri()]
    try:
        done = subprocess.run(command, capture_output=True, timeout=PATIENCE_S, check=False)
    except (OSError, subprocess.TimeoutExpired) as error:
        msg = f"{browser}: printing the page failed ({error})"
        raise CyclekitError(msg, cure="Open the page in a browser and print it to PDF.") from error
    if not printed.is_file():
        said = done.stderr.decode(errors="replace").strip().splitlines()[-1:] or [f"code {done.returncode}"]
        msg = f"{browser}: printing the page failed ({said[0]})"
        raise CyclekitError(msg, cure="Open the page in a browser and print it to PDF.")
    return printed.read_bytes()


def pages_of_sections(printed: bytes) -> dict[str, int]:
    """Return the page, from 1, on which each target of a link begins; empty where the PDF does not say it in plain."""
    objects = {int(number): body for number, body in _OBJECT.findall(printed)}
    root = next((body for body in objects.values() if b"/Type /Pages" in body and b"/Parent" not in body), b"")
    targets = re.search(rb"/Dests (\d+) 0 R", printed)
    if not root or targets is None:
        return {}

    def leaves(body: bytes) -> Iterator[int]:
        kids = re.search(rb"/Kids \[([^\]]*)\]", body)
        for kid in map(int, re.findall(rb"(\d+) 0 R", kids[1]) if kids else ()):
            inner = objects.get(kid, b"")
            yield from leaves(inner) if b"/Type /Pages" in inner else (kid,)

    numbers = {page: number for number, page in enumerate(leaves(root), start=1)}
    found = re.findall(rb"/([\w-]+) \[(\d+) 0 R", objects.get(int(targets[1]), b""))
    return {name.decode(): numbers[int(page)] for name, page in found if int(page) in numbers}


def with_page_numbers(text: str, pages: Mapping[str, int]) -> str:
    """Fill the page numbers of the table of contents in."""
    return _PAGE_OF.sub(lambda found: f"{found[0]}{pages.get(found[1], '')}", text)
