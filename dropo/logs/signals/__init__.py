"""Methods for measured signals: stamps, clocks, delays, resampling, velocities, states.

They take arrays, but for `clocks` (recordings) and `states` (problems), and may import `core`,
`mjmodel` and each other. A new one is a function from arrays to arrays, with a settings object.
"""
