"""The simulated vehicle under control: which trajectories can be followed, and how well."""
