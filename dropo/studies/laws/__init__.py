"""Laws that no effect stands for, hidden in simulated data and looked for."""
