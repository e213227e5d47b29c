"""A mapping guessed from the names and numbers of a log: `guess.py` shows it step by step.

Words of column names become quantities (`words.py`), columns are read once (`log_columns.py`) and
become joints (`places.py`) and sensors (`sensor_entries.py`), numbers tell units (`scales.py`), and
what moves beside the joints is a base (`base.py`).
"""
