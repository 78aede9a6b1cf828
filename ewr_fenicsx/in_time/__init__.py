"""What becomes of a periodic motion in time: a period stepped once, and whether small deviations grow."""
