"""How far predictions are off, before and after: at every horizon, in windows, over whole runs.

They import `diagnosis.search` and `evaluation`. Add a measure as a file that returns a record.
"""
