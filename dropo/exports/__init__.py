"""Fits and extended models in the form of other tools, one file a target."""
