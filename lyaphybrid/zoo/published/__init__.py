"""Published chaotic flows as tables: equations, parameters, sources and reference spectra."""
