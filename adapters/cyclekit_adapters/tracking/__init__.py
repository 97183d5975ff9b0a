"""Code shared by logs of people: motion-capture headers, markers, joints, counts, and one position per body."""
