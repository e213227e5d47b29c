"""A fit: its typed parts, the table that it prints, and the files that keep it.

`fit` has the class; the parts are by topic in the modules beside it. A part more is a frozen
dataclass that also says its entries of fit.json and its arrays of fit.npz (see `fit_parts`).
"""
