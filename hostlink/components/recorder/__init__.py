"""Recordings in MCAP files, the black box, and their reading and playback."""
