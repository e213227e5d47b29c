"""Effects on what sensors show."""
