"""Effects between a command and the force of its actuator, one a file.

They import `core`, `mjmodel` and `dropo.effects.support`, and no other effect.
To add one, write a function from an `EffectContext` to its instances in a file of that name, with a
hook `command`, `actuation`, `command_feedback` or `model`; name it in
`dropo.core.services.registry` and run `dropo.testing.check_effect`.
"""
