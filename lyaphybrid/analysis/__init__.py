"""The public verbs: spectra, trajectories, derivatives; subpackages for indicators, orbits, diagrams and gradients."""
