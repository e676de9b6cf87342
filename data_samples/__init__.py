"""Sample surfaces and scenes that travel with morphofold; each folder says its origin and licence."""
