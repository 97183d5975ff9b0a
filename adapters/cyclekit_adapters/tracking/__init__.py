"""Tables of people: headers of motion capture, markers, joints, sightings, and one body out of many points."""
