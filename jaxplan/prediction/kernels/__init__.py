"""What a cycle's prediction takes most of its time for, compiled (host)."""
