"""Simulated robots under control, problems on the data they record, and effects hidden in them.

May import `core`, `mjmodel`, `simulators` and `problems.hopper`.
To add a robot, add its builder to `ROBOTS` in `robots.py`.
"""
