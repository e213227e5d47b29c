"""What a search has found, in the parts of a `Diagnosis`: causes, alternatives, what remains.

It may import `diagnosis.search`, `evaluation`, `core`, `mjmodel` and `data.outliers`. A part more
is a file that returns a record, called by `diagnose`.
"""
