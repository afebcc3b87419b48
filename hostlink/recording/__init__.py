"""What happened, kept in MCAP files: recordings, the black box, reading and playing them."""
