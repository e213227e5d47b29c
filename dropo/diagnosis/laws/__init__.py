"""Laws of force that no known effect stands for: their formulas, found in what remains.

`forces` finds what remains at the joints, `shapes` lists the terms of formulas, `pursuit` and
`discovery` put formulas together, and `curve` is the force beside the law that stands for it. It
may import `core`, `mjmodel`, `effects`, `simulators.mujoco`, `diagnosis.findings` and
`diagnosis.search`. Another term is a `Shape` that `shapes_at` gives.
"""
