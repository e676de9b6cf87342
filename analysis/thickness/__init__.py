"""Cortical thickness between white and pial, and gyral thickness from wall to wall."""
