"""Times of logs: units of counts and how one is proven, dates and times of day in text, coarse stamps."""
