"""Diagnosis of a link from the traffic on its wire: evidence, rules and findings. Pure."""
