"""What a surface must be before it is measured: refusals, repairs and warnings."""
