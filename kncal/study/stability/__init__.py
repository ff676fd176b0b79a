"""Where a case stops to be simulated right: edges in the time step, and what lies beyond them."""
