"""A rule read from a TOML file: `[[limits]]` with their conditions, `[law]` or `[line]`."""

from __future__ import annotations

from pathlib import Path

import msgspec

from cyclekit_sim.errors import SimulationError
from cyclekit_sim.rules import Rule


def read_rule(path: Path) -> Rule:
    """Read a rule.

    Raises:
        SimulationError: The file cannot be read or holds no valid rule; the message names file and key.
    """
    try:
        return msgspec.toml.decode(path.read_bytes(), type=Rule, strict=True)
    except (OSError, UnicodeDecodeError, msgspec.MsgspecError) as error:
        raise SimulationError(f"{path}: {error}") from error
