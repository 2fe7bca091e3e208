"""From a path to a sequence: data sets, odometry, facts of the sensor, and digests."""
