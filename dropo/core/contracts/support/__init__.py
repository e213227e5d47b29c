"""What is made of contracts alone: maximization, Fisher scoring, fits by name, shared-out work.

No plug-in derives from these; they call plug-ins. Add a module here if it works with every part
that keeps its contract.
"""
