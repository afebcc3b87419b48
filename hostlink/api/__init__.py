"""Translates between the hub and the programs that drive robots; decides nothing."""
