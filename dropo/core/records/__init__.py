"""What passes between the rooms: parameters, trajectories, predictions; fits in `fits/`.

They import services and numerics. Add a frozen dataclass that checks its arrays when it is made.
"""
