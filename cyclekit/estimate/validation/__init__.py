"""Validation on logged executions: the backtest, its bias and spread, and the mean that history alone gives."""
