"""Runs compared with reference runs of the same machine: what differs, where, and how much.

May import what `diagnosis` may.
"""
