"""One cycle walked: the robot along its legs beside a track of the operator, by network, rule or signal."""
