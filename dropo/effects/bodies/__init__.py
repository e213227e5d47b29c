"""Effects on bodies, one a file: masses, gravity, air, contacts, forces from outside.

They import `core`, `mjmodel` and `dropo.effects.support`, and no other effect.
To add one, write a function from an `EffectContext` to its instances in a file of that name, with a
hook `model` or `wrench`; name it in `dropo.core.services.registry` and run
`dropo.testing.check_effect`.
"""
