"""The study of accuracy: errors and times of many settings of the solver and the analysis, and of peers."""
