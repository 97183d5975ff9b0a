"""What comes with an extra of the installation, and a refusal that names the command where it is missing."""

from __future__ import annotations

from importlib import import_module

from cyclekit.errors import MissingExtra

EXTRAS = {
    "excel": ("fastexcel", "xlsxwriter"),
    "onnx": ("onnx",),
    "ray": ("ray",),
    "replay": ("rerun",),
    "simulate": ("mcap", "ruckig"),
    "train": ("torch",),
}
"""What has to be importable for each extra of pyproject.toml."""


def need(purpose: str, *extras: str) -> None:
    """Refuse to begin what cannot be finished because a package is missing.

    Args:
        purpose: What needs the packages, as the message begins.
        extras: Which extras it needs; all that are missing are named at once.

    Raises:
        MissingExtra: A package of them cannot be imported.
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
