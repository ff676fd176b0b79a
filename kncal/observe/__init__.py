"""From a record to numbers with uncertainties, and from two of them to a verdict; knows no engine."""
