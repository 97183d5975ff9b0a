"""Installed packages: versions, and an error with the install command if an extra of the installation is missing."""

from __future__ import annotations

from functools import cache
from importlib import import_module
from importlib.metadata import version as installed

from cyclekit.errors import MissingExtra

EXTRAS = {
    "excel": ("fastexcel", "xlsxwriter"),
    "onnx": ("onnx",),
    "ray": ("ray",),
    "replay": ("rerun",),
    "simulate": ("mcap", "ruckig"),
    "train": ("torch",),
}
"""Packages that each extra of pyproject.toml must provide."""


@cache
def version() -> str:
    """Return the version of cyclekit; its metadata is read once, which takes 4 ms."""
    return installed("cyclekit")


def need(purpose: str, *extras: str) -> None:
    """Raise an error before the work starts if a package is missing.

    Args:
        purpose: What needs the packages, as start of the message.
        extras: Extras that it needs; the message names all missing ones.

    Raises:
        MissingExtra: A package of these extras cannot be imported.
    """
    missing = {extra: absent for extra in extras if (absent := [name for name in EXTRAS[extra] if not _found(name)])}
    if missing:
        packages = " and ".join(name for absent in missing.values() for name in absent)
        raise MissingExtra(packages, ",".join(missing), purpose)


def _found(package: str) -> bool:
    try:
        import_module(package)
    except ImportError:
        return False
    return True
