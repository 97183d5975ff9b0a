"""Expected cycle time per task sequence, out of a learned safety function and logged operator tracks."""
