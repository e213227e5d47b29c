"""Models that lack many numbers at once: found by regression, fitted to whole motions.

An output-error fit: long windows are simulated from their measured starts, and every step of them
is compared. Short windows would hand over, at each start, what friction and load should have made.
It may import `core`, `mjmodel`, `evaluation`, `diagnosis.search` and `diagnosis.regression`. A kind
of effect that motions may ask for too is a name in `families` or `laws` of `FarOffSettings`.
"""
