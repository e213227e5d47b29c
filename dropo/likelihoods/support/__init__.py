"""What several likelihoods share: Gaussian rows, polynomials, axial differences, blocks.

It imports `core` alone.
A new part is a file with functions on arrays, or a base of local likelihoods like `GaussianRows`.
"""
