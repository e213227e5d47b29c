"""Raw logs on their way to data: `importing.py` shows it step by step.

It may import `core`, `mjmodel` and the checks of `data`. A new key of mapping files is a field in
`mapping_schema.py`; new formats belong in `readers/`, new methods for signals in `signals/`.
"""
