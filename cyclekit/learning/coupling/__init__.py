"""Learns the wait conditions of robot and operator from their visits to places and from signals.

`visits` has when each agent came and went, and the signals; `departures` has the departures, gate by gate; `conditions`
finds what they wait for (`machines`: a machine that the robot has loaded), `alike` what only several places of one
kind show, `circles` which of it cannot be; `lags` tells own work from waiting in max(own work, event + lag); `sources`
learns how parts come, `unseen_parts` the same from the robot's standstills alone (`part_visits`, `part_gaps`,
`part_chains` across executions), `answers` how somebody unseen answers the robot, `together` which departures both wait
in; `learn` makes the card.
"""
