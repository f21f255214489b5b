"""What a quadrotor is, and what a trajectory demands of it."""
