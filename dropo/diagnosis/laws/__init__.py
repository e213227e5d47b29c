"""Laws of force that no known effect stands for: their formulas, found in what remains."""
