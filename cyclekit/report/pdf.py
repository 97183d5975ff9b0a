"""The page as PDF, printed by an installed browser.

A browser prints the page as the reader sees it, with vector pictures, and needs no further dependency: Windows comes
with Edge, and most other machines have Chromium or Chrome. The page's content policy blocks loading anything else.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

from cyclekit.errors import CyclekitError
from cyclekit.storage.atomic import replaced
from cyclekit.storage.scratch import Scratch

NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome", "msedge", "microsoft-edge")
_PLACES = (
    ("PROGRAMFILES(X86)", "Microsoft/Edge/Application/msedge.exe"),
    ("PROGRAMFILES", "Microsoft/Edge/Application/msedge.exe"),
    ("PROGRAMFILES", "Google/Chrome/Application/chrome.exe"),
)
_MAC = ("Google Chrome.app/Contents/MacOS/Google Chrome", "Microsoft Edge.app/Contents/MacOS/Microsoft Edge")
PATIENCE_S = 120.0


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

    Returns:
        Size of the PDF in bytes.

    Raises:
        CyclekitError: No browser is installed, or it fails, or the file cannot be written.
    """
    browser = need_browser()
    with Scratch() as scratch, replaced(out) as temporary:
        printed = scratch.path / "page.pdf"
        options = [*browser_options(scratch.path / "profile"), "--no-pdf-header-footer", f"--print-to-pdf={printed}"]
        try:
            done = subprocess.run(
                [str(browser), *options, page.resolve().as_uri()], capture_output=True, timeout=PATIENCE_S, check=False
            )
        except (OSError, subprocess.TimeoutExpired) as error:
            msg = f"{browser}: printing the page failed ({error})"
            raise CyclekitError(msg, cure="Open the page in a browser and print it to PDF.") from error
        if not printed.is_file():
            said = done.stderr.decode(errors="replace").strip().splitlines()[-1:] or [f"code {done.returncode}"]
            msg = f"{browser}: printing the page failed ({said[0]})"
            raise CyclekitError(msg, cure="Open the page in a browser and print it to PDF.")
        temporary.write_bytes(printed.read_bytes() + b"\n% written by cyclekit\n")  # a PDF comment: viewers ignore it
    return out.stat().st_size
