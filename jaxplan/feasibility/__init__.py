"""Which trajectories the vehicle can follow: a learned, two-fidelity classifier."""
