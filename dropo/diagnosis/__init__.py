"""What a simulation gets wrong, and why: from data and a model to a `Diagnosis`.

`search` looks for causes, `findings` says what they are; both import `core`, `mjmodel`, `effects`
by name, `evaluation` and `data.outliers`. Candidate causes themselves are files of `effects`.
"""
