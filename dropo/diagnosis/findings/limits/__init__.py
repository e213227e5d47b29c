"""What the data cannot say: effects too small to be seen, numbers and causes that look alike.

They import `diagnosis.search`, `evaluation` and the simulators' layers. Add a limit as a file that
returns a record.
"""
