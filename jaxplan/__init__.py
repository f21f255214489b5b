"""jaxplan: sampling-based online planning for drone interception."""
