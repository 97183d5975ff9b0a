"""A command killed at any moment leaves its old result or its new one, and the next run goes on without help."""

from __future__ import annotations

from typing import Any

import pytest

from cyclekit.storage.atomic import recover

pytestmark = pytest.mark.slow  # quick: every write fails once (test_failing_writes), one killed ingest (test_whole_way)


@pytest.mark.parametrize(
    ("command", "times"),
    [
        ("ingest", 3),
        ("ingest of other logs", 3),
        ("estimate", 4),
        ("simulate", 3),
        ("convert to csv", 2),
        ("convert to parquet", 2),
        ("replay", 3),
        ("train", 1),
        ("report", 1),
    ],
)
def test_a_command_killed_at_any_moment_leaves_the_old_result_or_the_new_one(
    command: str, times: int, kill_nine: Any, terminal: Any, victims: dict[str, Any]
):
    killed = 0
    for seed in range(11, 16):  # on a busy machine a command may end before it is killed
        count = kill_nine.kill(victims[command], times, terminal, recover, seed=seed)
        assert count.broken == []
        assert count.old + count.new == times
        killed += count.killed
        if killed:
            break
    assert killed > 0


def test_a_half_written_result_would_be_noticed(kill_nine: Any, terminal: Any, victims: dict[str, Any]):
    estimate = victims["estimate"]

    def harm(target: Any) -> None:
        target.write_bytes(target.read_bytes()[:-5])

    assert len(kill_nine.kill(estimate, 2, terminal, harm).broken) == 2
