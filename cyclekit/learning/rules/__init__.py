"""The safety function as a rule that a person can read: which level holds where, the simplest that explains the logs.

rows        positions and commanded level of each sample (`positions`, `distances`, `links`, `signals`)
families    the kinds of rules, one module each: presence, distance, rectangle, polygon, region of the robot, signal
ladder      which kind explains the commanded level on held-out executions
fitting     one kind fitted: a region for each level, with hysteresis two (`cuts`, `crossings`, `intervals`)
regions     where a region holds; `quantities` its thresholds and edges one by one
law         the continuous law in place of levels (`law_rows`); `law_evidence` decides whether it is one
safety      a rule asked in place of the network
words       the rule as it would be written into a safety controller; `shapes` as outlines on the floor
"""
