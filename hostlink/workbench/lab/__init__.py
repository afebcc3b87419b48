"""The laboratory: the paper's measurements, driven again in a world that is known."""
