"""How good a fit is and how sure: errors on held-out data, residual tests, uncertainty, design.

It may import `core` and `mjmodel`; estimators, problems, diagnosis and studies import it. An
evaluation more is a file with one function that takes a problem and a fit, and returns a record or
sentences.
"""
