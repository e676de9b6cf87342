"""Optional effects, one file each; a scene that does not name an effect never imports it."""
