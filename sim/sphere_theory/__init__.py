"""The growing sphere before it folds: its smooth state and its linear stability, by two independent methods."""
