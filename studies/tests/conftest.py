"""The fixtures of the other tests: ``python -m pytest studies`` runs these, which the default run leaves out."""

from conftest import cwd, quick_searches, rng  # noqa: F401
