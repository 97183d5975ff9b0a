"""Bootstrap over executions, conformal intervals, and which executions are comparable. Used by all of `estimate`."""
