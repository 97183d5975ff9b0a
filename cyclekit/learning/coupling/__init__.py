"""Learns the wait conditions of robot and operator from their visits to places and from signals.

`visits` holds arrivals, departures and signal changes; `passages` holds the departures per gate; `conditions` finds the
events that they wait for; `lags` separates own work from waiting in max(own work, event + lag); `sources` and
`unseen_parts` learn how parts arrive; `together` finds passages in which both agents wait; `learn` builds the card.
"""
