"""What happened in the logs: visits to places, trips and errands, signals and who gave them."""
