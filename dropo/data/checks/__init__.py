"""What looks odd in data, and in the raw logs that data are made of.

It may import `core`, `mjmodel` and `dropo.data.describe`. A new check yields `Finding`s, and its
thresholds are fields of a settings object; `check.py` calls it for data, and
`dropo.logs.log_checks` for logs.
"""
