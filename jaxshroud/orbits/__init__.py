"""What a motion is: its period number, power, spectrum, orbit and exponents."""
