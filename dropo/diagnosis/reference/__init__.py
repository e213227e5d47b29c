"""Runs compared with reference runs of the same machine: what differs, where, and how much.

`candidates` lists what may differ and how predictions respond to it, `compare` decides, and
`result` is what it says. It may import `core`, `mjmodel`, `data.outliers`, `diagnosis.parts` and
`diagnosis.search`. Another candidate is an effect of the registry, or a `Candidate` of its own kind
in `candidates`.
"""
