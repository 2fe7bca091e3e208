"""Recordings read back: checked, repaired, shown, and rendered as pictures and clips."""
