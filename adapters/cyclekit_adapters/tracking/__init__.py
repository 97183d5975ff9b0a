"""Code shared by logs of people: motion-capture headers, markers, joints, sightings, and one position per body."""
