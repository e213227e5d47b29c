"""The study `crazypad`: which rotor of a quadrotor differs from its normal flights.

May import `core`, `problems`, `diagnosis.reference` and `studies.engine`. Its flights are those of
the external data; another figure of them is a table that `study.py` makes of what was compared.
"""
