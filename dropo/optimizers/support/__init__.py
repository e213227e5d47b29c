"""What several optimizers or samplers share; it imports `dropo.core` alone.

`real_line` maps a density on the unit box to one on the real line, for Pyro's samplers.
A new helper comes here as soon as a second optimizer or sampler needs it.
"""
