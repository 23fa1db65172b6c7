"""Flight data: channels and their units, the clock, checks, faults, smoothing, frames, the atmosphere."""
