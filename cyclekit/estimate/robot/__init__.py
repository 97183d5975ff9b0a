"""The robot in an estimate: nominal motion, dwells, program order, and what the safety function makes of its speed."""
