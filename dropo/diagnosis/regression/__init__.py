"""Inverse dynamics as a regression: all that acts linearly on the joints' forces, in one solve.

No simulation is run here. What it finds is where a search by simulation starts.
"""
