"""Who waits for whom: conditions of the departures of robot and operator, learned from their visits and signals.

`visits` has when each agent came and went, and the signals; `passages` has the departures, gate by gate; `conditions`
finds what they wait for; `lags` tells own work from waiting in max(own work, event + lag); `sources` and
`unseen_parts` learn how parts come, `together` which passages both wait in; `learn` makes the card.
"""
