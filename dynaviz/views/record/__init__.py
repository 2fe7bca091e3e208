"""What a run records: the recorder, its layout of states, and the parts of a recording."""
