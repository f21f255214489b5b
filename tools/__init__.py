"""What makes the project's site, notebooks, pictures and releases; nothing of it is installed."""
