"""Tables that a map in the cell file describes, and the draft of such a map for an unknown table."""
