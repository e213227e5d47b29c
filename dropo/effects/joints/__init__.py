"""Effects at joints and tendons, one a file: rotors, friction, springs, stops, gears.

They import `core`, `mjmodel` and `dropo.effects.support`, and no other effect.
To add one, write a function from an `EffectContext` to its instances in a file of that name, with a
hook `force` or `friction`, or for a number of the model a `ModelField`; name it in
`dropo.core.services.registry` and run `dropo.testing.check_effect`.
"""
