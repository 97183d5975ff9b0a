"""Code shared by logs of robot controllers: clocks, binary records, arm kinematics."""
