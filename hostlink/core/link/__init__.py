"""Link: one Session on one Transport, from the connect to a named end."""
