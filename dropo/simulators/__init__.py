"""Simulators: MuJoCo, Gymnasium's environments, torch, any Python function, and toys.

They import `core` and, where they have a model, `mjmodel`; nothing above this room steps a
simulator. A new one subclasses `Simulator`, sets `space` and `signals`, and writes `_predict`.
"""
