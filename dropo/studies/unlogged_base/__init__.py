"""Machines on legs of which angles and an IMU are logged, and no pose: fits and quick diagnoses.

`machines` says what is hidden in the example on legs, `study` fits and diagnoses its logs. May
import `core`, `logs`, `problems`, `diagnosis`, `estimators` and `studies.engine`. To hide something
else, add it to `HIDDEN` of `machines.py`.
"""
