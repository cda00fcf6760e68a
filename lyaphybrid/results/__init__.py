"""Results of runs: the spectrum with its errors, the hybrid time domain, the set of solutions."""
