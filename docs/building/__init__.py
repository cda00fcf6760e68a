"""Programs that make pages: assembling the sources, the reference, the evidence, and the checks of what comes out."""
