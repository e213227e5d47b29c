"""Forces: of actuators, friction and contacts, and those that a motion needs."""
