"""Results of runs: saved, shown, collected, and checked against a baseline."""
