"""Simulation of an aircraft with a learned model."""
