"""One HTML page of a fit, a diagnosis or a run at work, as a file or served.

It imports core, mjmodel, plots, what a diagnosis holds, and problems for the robot's picture. Add a
section as a function from a `Result` to a `Section`, and put it into the page of its kind.
"""
