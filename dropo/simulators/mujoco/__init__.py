"""MuJoCo in batches: replay of segments, closed loops, episodes, inferred actions.

It imports `core` and `mjmodel`. What effects do outside of the physics is in `layers`, what they do
to the model and its steps in `worker`.
"""
