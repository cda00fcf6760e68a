"""The public verbs: spectra, trajectories, derivatives; rooms for indicators, orbits, diagrams and gradients."""
