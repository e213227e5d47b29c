"""Families of parameter distributions, one family a file.

A family imports `dropo.core` alone, and no other family.
To add one, write a subclass of `dropo.core.contracts.family.Family` with `unknowns`, `_draw`,
`mean` and `sd`, name it in `dropo.core.services.registry` and run `dropo.testing.check_family`.
"""
