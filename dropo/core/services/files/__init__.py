"""Files: written whole or not at all, read strictly, and journals from which a run goes on.

They import the errors and checks beside them. Add a module here if it says how a file is written or
read, whatever stands in it.
"""
