"""Whether a surface passes through itself, exactly."""
