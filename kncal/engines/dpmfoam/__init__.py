"""The gas: OpenFOAM's DPMFoam, its case, and the two transports to it."""
