"""Laws, impacts, methods, calibration, time steps, drag, statistics: numbers in, numbers out."""
