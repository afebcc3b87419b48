"""The hostlink command; serve is the composition root."""
