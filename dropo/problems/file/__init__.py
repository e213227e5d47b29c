"""Problem files: their schema, their reader and their writer.

It may import `core`, `mjmodel`, `data`, `logs` and `simulators`. A new key is a field in
`schema.py`, a function that reads it for `reader.py`, and a line in `writer.py`.
"""
