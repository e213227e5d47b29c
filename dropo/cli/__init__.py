"""The commands of `dropo`, a thin layer over the Python interface that prints the same numbers.

It comes last and may import every room, each inside the function that needs it. Add a command as a
file with `add(commands)` and `run(arguments)`, and name the file in `main`. The list of files is
the list of commands, and so it stays flat; what commands share is in `support/`.
"""
