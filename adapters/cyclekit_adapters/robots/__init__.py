"""What logs of robot controllers share: their clocks, their binary records, the links of an arm."""
