"""The safety function as a readable rule: which level applies where; the simplest rule that explains the logs.

rows        positions and commanded level of each sample (`positions`, `distances`, `links`, `signals`)
families    the kinds of rules, one module each: presence, distance, rectangle, polygon, region of the robot, signal
ladder      selects the kind that explains the commanded level on held-out executions
fitting     fits one kind: one region per level, two with hysteresis (`cuts`, `crossings`, `intervals`)
brackets    places edges that few operators crossed; `polygon_mean` places the sides of polygons that are needed
            (`polygon_sides`, `polygon_fit`); `dated` reads from the log when the level changed between two samples
regions     tests where a region holds; `quantities` lists its thresholds and edges
law         fits the continuous law in place of levels (`law_rows`); `law_evidence` decides whether it applies
safety      predicts the scaling by a rule in place of the network
words       writes the rule as for a safety controller; `shapes` draws it as outlines on the floor
"""
