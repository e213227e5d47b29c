"""Problem files: their schema, their reader and their writer."""
