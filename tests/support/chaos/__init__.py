"""Chaos against a real daemon: a seeded generator of devices and programs, one honest robot, invariants that hold."""
