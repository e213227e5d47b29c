"""How good a fit is and how sure: errors on held-out data, residual tests, uncertainty, design.

It may import `core` alone; estimators, diagnosis and report import it. An evaluation more is a file
with one function that takes a problem and a fit, and returns a record or sentences.
"""
