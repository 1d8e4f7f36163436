"""What a computed motion says: samples, spectra, period numbers, power and energy."""
