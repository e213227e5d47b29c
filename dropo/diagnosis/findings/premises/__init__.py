"""What must hold before a cause is sought: columns, commands, joints that move, small steps.

They import `diagnosis.search`, `regression` and the result. Add a premise as a file whose function
says what does not hold, called by `diagnose`.
"""
