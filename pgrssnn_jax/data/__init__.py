"""Measured data: one file per system, which finds it, checks it and splits it as published, or simulates it."""
