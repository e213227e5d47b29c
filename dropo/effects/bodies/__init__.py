"""Effects on bodies: masses, gravity, air, contacts, forces from outside."""
