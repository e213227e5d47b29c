"""The study of first models: what regression finds of machines whose models lack much at once.

May import `core`, `diagnosis`, `problems`, `simulators` and the engine.
To add a machine, describe it in `DESIGNS` of `machines.py`.
"""
