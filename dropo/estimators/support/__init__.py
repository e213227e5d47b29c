"""What several estimators share: trust regions, filtered starts, standard errors, noise, summaries.

It imports `core`, `evaluation` and the estimators that are parts of others, never `likelihoods`.
A new part is a file with functions of a problem and a run that more than one method needs.
"""
