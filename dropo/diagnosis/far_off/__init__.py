"""Models that lack many numbers at once: found by regression, fitted to whole motions.

An output-error fit: long windows are simulated from their measured starts, and every step of them
is compared. Short windows would hand over, at each start, what friction and load should have made.
"""
