"""Problems on logs of real machines, and where such external data are searched for.

May import `core`, `mjmodel`, `simulators` and `logs`.
To add one, read its runs with `find_runs`, build its simulator and return `measured(...)`.
"""
