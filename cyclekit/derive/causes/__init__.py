"""Causes of lost time: people, inputs, limits of the path, slow recoveries, protective stops."""
