"""The safety function as a rule that a person can read: which level holds where, the simplest that explains the logs.

rows        positions and commanded level of each sample
families    the kinds of rules, one module each: presence, distance, rectangle, two of these at once
ladder      which kind explains the commanded level on held-out executions
fitting     one kind fitted: a region for each level, with hysteresis two (`cuts`, `crossings`, `intervals`)
regions     where a region holds; `quantities` its thresholds and edges one by one
law         the continuous law in place of levels (`law_rows`); `law_evidence` decides whether it is one
words       the rule as it would be written into a safety controller
"""
