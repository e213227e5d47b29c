"""Models of files and descriptions, the motors that are mounted on them, and files of models."""
