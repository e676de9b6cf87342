"""Pictures of surfaces, with or without a graphics library."""
