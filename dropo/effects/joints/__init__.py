"""Effects at joints and tendons: rotors, friction, springs, stops, gears."""
