"""Tests of the firmware's C++ on the PC: as libraries and as processes."""
