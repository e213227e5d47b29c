"""Samplers of posterior densities, one method a file.

They import `dropo.core` and `dropo.optimizers.support`, and no other sampler.
To add one, write a subclass of `dropo.core.contracts.sampler.Sampler`, name it in
`dropo.core.services.registry` and run `dropo.testing.check_sampler`.
"""
