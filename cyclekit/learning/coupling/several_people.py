"""Whether logs show several people at once, who are taken for one: the nearest to the TCP.

The visits of that composite jump between people, so who waits for whom cannot be learned from them.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cyclekit.dataset.cards import RecordingCard

SEVERAL = 0.01
"""Share of the samples with people above which several at once matter. A tolerance for strangers who pass, and for
ids that are lost while the new one is there: one person alone has 0, also with ids lost every 5 s, two workers beside
one robot 0.93 to 1, so half and twice of it change nothing."""


def several_people(recordings: Sequence[RecordingCard]) -> float:
    """Return in which share of the samples with people several are seen at different places; 0 up to SEVERAL."""
    cards = [one.operator for one in recordings if one.operator is not None]
    share = sum(card.several for card in cards) / max(sum(card.seen for card in cards), 1)
    return share if share > SEVERAL else 0.0
