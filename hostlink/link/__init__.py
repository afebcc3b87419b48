"""One Session on one Transport, from connect to a named end."""
