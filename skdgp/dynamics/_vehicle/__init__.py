"""The aircraft: mass and geometry, propeller, thrust."""
