"""What a simulation gets wrong, and why: from data and a model to a `Diagnosis`.

`search` looks for causes, `findings` says what they are; both import `core`, `mjmodel`, `effects`
by name, `evaluation` and `data.outliers`. `regression` and `laws` take how commands and laws act
from `simulators.mujoco`, and step nothing. Candidate causes themselves are files of `effects`.
"""
