"""Policies trained and evaluated in simulations whose parameters are drawn from a distribution.

It imports `core`, `mjmodel`, `simulators` and `problems`; only studies and commands import it.
To add a training algorithm, write a frozen dataclass with `name` and `train` as `train.Algorithm`
asks for.
"""
