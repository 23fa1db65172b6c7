"""Simulation of learned aircraft."""
