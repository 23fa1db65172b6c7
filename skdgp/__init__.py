"""Aircraft aerodynamics from flight logs with dependent Gaussian processes, as ordinary scikit-learn."""
