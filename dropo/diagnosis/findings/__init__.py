"""What a search has found, in the parts of a `Diagnosis`: causes, and how stable they are.

Four folders hold the rest: `premises/` that must hold before, `limits/` of the data, `accuracy/` of
predictions, `remains/` that no cause explains. They may import `diagnosis.search`, `evaluation`,
`core`, `mjmodel` and `data.outliers`. A part more is a file that returns a record, called by
`diagnose`.
"""
