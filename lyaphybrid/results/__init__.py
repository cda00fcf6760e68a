"""What a run gives back: the spectrum, its errors, the hybrid time domain, the set of solutions."""
