"""Models of an operator that no log shows, learned from the speed scaling alone."""
