"""Makes robot simulators honest: fits the distribution of a simulator's parameters to measured motion."""

__version__ = "0.1.0"
