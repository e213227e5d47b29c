"""Two problems of an arm, simulation against simulation: a puck is struck, a box is pushed.

May import `core`, `mjmodel` and `simulators`.
To add one, write its MJCF file, its simulator, its target and a function that records the data.
"""
