"""One HTML page of a fit, a diagnosis or an unfinished run, and a video of the motion.

It imports core, mjmodel, plots and what a diagnosis holds. Add a section as a function from a
`Result` to a `Section`, and put it into the page of its kind.
"""
