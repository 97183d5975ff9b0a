"""The operator's pace: drift over the executions, slow and quick executions, own work by destination."""
