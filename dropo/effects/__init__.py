"""Candidate effects, one a file: what a simulation may get wrong, and by how much.

A folder for what acts at actuators, bodies, joints and tendons, and sensors; what can be anywhere
stands beside them. They import `core` and `mjmodel`, and their shared parts from `support`, never
a simulator. A new effect is a function from an `EffectContext` to its instances, registered under
`effects`.
"""
