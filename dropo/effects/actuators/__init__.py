"""Effects between a command and the force of its actuator."""
