"""The study `crazypad`: which rotor of a quadrotor differs from its normal flights.

May import what `studies` may.
"""
