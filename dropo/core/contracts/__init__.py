"""What plug-ins derive from: simulators, families, likelihoods, optimizers, samplers, estimators.

They import the three floors below. Add a contract as an abstract class: its public methods check
what goes in and comes out, a plug-in writes the private ones; name it in `dropo/core/__init__.pyi`.
What works with every plug-in by its contract is in `support/`.
"""
