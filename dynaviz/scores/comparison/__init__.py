"""What differs between two runs on the same points."""
