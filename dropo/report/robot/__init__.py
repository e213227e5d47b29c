"""The robot itself: its video, and a picture with the place of each cause.

They need a model, where the pages need none.
"""
