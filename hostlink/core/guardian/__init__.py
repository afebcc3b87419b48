"""Guardian: separate process that stops the robots when the daemon died or hangs."""
