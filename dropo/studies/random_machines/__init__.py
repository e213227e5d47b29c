"""The study of random machines: what a quick diagnosis says of chains that nobody drew by hand.

May import `core`, `diagnosis`, `simulators` and the engine.
To hide another thing, add a function to `THINGS` of `hidden.py`.
"""
