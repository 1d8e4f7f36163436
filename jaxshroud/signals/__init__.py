"""Statistics of the samples of motions: powers, amplitudes, periods, spectra, waves."""
