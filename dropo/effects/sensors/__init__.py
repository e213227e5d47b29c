"""Effects on what sensors show, one a file.

They import `core`, `mjmodel` and `dropo.effects.support`, and no other effect.
To add one, write a function from an `EffectContext` to its instances in a file of that name, with a
hook `measurement` or `sensor_delay` and a hook `start` that undoes it; name it in
`dropo.core.services.registry` and run `dropo.testing.check_effect`.
"""
