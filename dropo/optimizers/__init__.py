"""Optimizers over the unit box, one library or method a file, and samplers in `samplers`.

They import `dropo.core` and their own `support`, and no other optimizer.
To add one, write a subclass of `dropo.core.contracts.optimizer.Optimizer`, name it in
`dropo.core.services.registry` and run `dropo.testing.check_optimizer`.
"""
