"""Real tosses of an acrylic cube onto a board (Pfrommer, Halm, Posa 2020, ContactNets), tracked at 148 Hz."""
