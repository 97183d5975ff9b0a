"""What departures wait for: lags, candidates, tests, and conditions at places of one kind."""
