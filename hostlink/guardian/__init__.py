"""guardian: a process of its own that stops the robots when the daemon's has ended without doing so."""
