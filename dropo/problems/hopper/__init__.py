"""The hopper of the thesis: its model, its data (simulated or published), its task, its problems.

May import `core`, `mjmodel`, `simulators`, `data` and `problems.measured.external_data`.
To add a problem on other hopper data, call `hopper_problem` with them and register the function.
"""
