"""Fits and extended models in the form of other tools, one file a target.

They import `core`, `mjmodel`, `effects`, `simulators` and `problems`; only commands import them.
`support/` holds what all targets share. A new target is a function from a `Subject` to what is
`Written`, registered under `exports`.
"""
