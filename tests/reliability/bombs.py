"""Files made to break a reader: small ones that unpack to gigabytes, sizes that lie, endless lines, traps in folders.

Each maker writes into an empty folder and returns what is to be ingested. What must come of each: a dataset or one
message, soon, in little memory.
"""

from __future__ import annotations

from reliability import bombs_binary, bombs_folders, bombs_text
from reliability.explosives import BOMBS, SLOW, Maker

__all__ = ["BOMBS", "SLOW", "Maker", "bombs_binary", "bombs_folders", "bombs_text"]
