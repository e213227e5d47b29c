"""What every study needs: its result, its tasks on an executor, its pages, and a call by name.

May import `core`.
Studies are added in the folders beside this one.
"""
