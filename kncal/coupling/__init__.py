"""Gas and particles together: two transports to the gas solver, one exchange loop."""
