"""The law of speed and separation monitoring (ISO/TS 15066): fitted, and told from a staircase."""
