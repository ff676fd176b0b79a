"""From a plan to solver input, and from there to a record."""
