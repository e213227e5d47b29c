"""The tables and figures of the thesis (Tiboni 2021), each a study.

May import `core`, `estimators`, `families`, `likelihoods`, `problems`, `training` and the engine.
To add a table or figure, write it in a file named after it and register it under "studies".
"""
