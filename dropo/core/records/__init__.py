"""What passes between the rooms: parameters, trajectories, fits and their parts, predictions.

They import services and numerics. Add a frozen dataclass that checks its arrays when it is made; a
part of a fit also says its entries of fit.json and its arrays of fit.npz (see `fit_parts`).
"""
