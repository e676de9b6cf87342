"""The simulation folder: its contents, and how they are written and read back."""
