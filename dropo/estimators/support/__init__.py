"""What several estimators share: trust regions, filtered starts, standard errors, noise, summaries.

It imports `core`, `mjmodel` and `evaluation`; methods and likelihoods it finds by name.
A new part is a file with functions of a problem and a run that more than one method needs.
"""
