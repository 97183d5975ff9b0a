"""The operator in an estimate: logged tracks, how they go on after their end, his pace, his courses and pauses."""
