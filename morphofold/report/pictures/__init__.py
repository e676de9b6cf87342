"""Pictures of surfaces, drawn without a graphics library."""
