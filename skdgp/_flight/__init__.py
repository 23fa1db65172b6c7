"""Flight data as such: channels and their units, the clock, checks, faults, smoothing, frames, the atmosphere."""
