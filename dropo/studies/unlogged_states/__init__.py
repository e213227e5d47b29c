"""Fits of logs whose states are noisy or only partly measured, against the Cramer-Rao bound.

Contents are found by name; nothing is exported here.
"""
