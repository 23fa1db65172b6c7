"""Flight mechanics, which `skdgp.dynamics` shows to users: the aircraft, the air, the equations of motion."""
