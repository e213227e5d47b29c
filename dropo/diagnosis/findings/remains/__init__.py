"""What no cause explains: residuals that are left, forces behind them, pushes and outlier runs.

They import `diagnosis.search`, `evaluation` and `data.outliers`. Add a test of what is left as a
file that returns a record.
"""
