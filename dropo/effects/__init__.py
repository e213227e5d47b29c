"""Candidate effects, one a file: what a simulation may get wrong, and by how much.

They import `core` and `mjmodel`, and their shared parts from `support`, never a simulator. A new
effect is a function from an `EffectContext` to its instances, registered under `effects`.
"""
